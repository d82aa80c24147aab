"""Fits that train a generator: the hybrid method, the paper's GAN, and plausible detail."""
