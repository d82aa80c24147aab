"""``mitsvbrdf doctor``: what is installed here, and whether it suffices."""

from .options import PrintJson, Variant


def doctor(variant: Variant = "llvm_ad_rgb", json: PrintJson = False) -> int:
    """Show what is installed, prove libLLVM in a child process, and say what is missing and how to get it."""
    from ..doctor import doctor as examine

    return examine(variant=variant, json=json)
