"""``mitsvbrdf pretrain``: the first stage of the paper's two-stage training."""

from __future__ import annotations

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction

from ..fit.gan_config import GanConfig
from ..io.progress import Progress, say
from ..render import RendererName, make_renderer
from ..views import Falloff
from .options import Out, Overwrite, Photos, Strict, Variant, check_new_files, read_photos

PAPER = GanConfig(preset="paper-two-stage")


def pretrain(picture: Positional[Photos], out: Out,
             config: UseAppendAction[OmitArgPrefixes[GanConfig]] = PAPER,
             resolution: int = 256, renderer: RendererName = "mitsuba", falloff: Falloff = "none",
             variant: Variant = "llvm_ad_rgb", overwrite: Overwrite = False, strict: Strict = False) -> int:
    """First stage of the paper's two-stage training: the generator learns from one picture with global
    features.

    CAPTURE's first photo is used; a folder with one plain photo will do. OUT is a .safetensors file, for
    `fit --method gan --preset paper-two-stage --pretrained OUT`.
    """
    from ..fit import pretrain as first_stage

    config.check()
    check_new_files(out, overwrite=overwrite, read=[picture])
    shots = read_photos(picture, resolution, None, "auto", falloff)
    engine = make_renderer(renderer, variant)
    with Progress(f"pretrain · {engine.name}") as progress:
        first_stage(shots, engine, config, out, progress)
    say(f"wrote {out}")
    return 0
