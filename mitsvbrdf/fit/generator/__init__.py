"""Fits by a generator: the hybrid method and the paper's GAN."""
