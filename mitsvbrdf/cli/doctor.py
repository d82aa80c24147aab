"""``mitsvbrdf doctor``: what is installed here, and whether it suffices."""

from typing import Annotated

from tyro.conf import arg

from .options import Variant


def doctor(variant: Variant = "llvm_ad_rgb", json: Annotated[bool, arg(help="Print JSON.")] = False) -> int:
    """Show what is installed, test libLLVM in a child process, and say what is missing and how to get it."""
    from ..doctor import doctor as examine

    return examine(variant=variant, json=json)
