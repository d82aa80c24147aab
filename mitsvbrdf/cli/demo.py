"""``mitsvbrdf demo``: a built-in material is photographed, recovered and compared with the truth."""

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from ..io import results
from ..io.progress import print_numbers, say
from .options import Out


def demo(out: Out = Path("demo"),
         budget: Annotated[float, arg(help="Seconds that the fit may take.")] = 75.0,
         overwrite: Annotated[bool, arg(help="Keep an earlier demo.", help_behavior_hint="")] = True) -> int:
    """Photograph a built-in material, recover it, and compare with the truth. Takes about two minutes."""
    from ..evaluate import evaluate_maps
    from ..fit.config import HierarchicalConfig
    from ..material.made import make_material
    from ..material.map_files import load_maps, save_maps
    from .fit import fit
    from .synth import synth

    truth, photos, result = out / "material", out / "capture", out / "fit"
    if overwrite and result.exists():
        say(f"replacing the earlier demo in {out}")
    with results.output_folder(truth, overwrite) as folder:
        save_maps(make_material("inlay", 256), folder)
    synth(str(truth), photos, noise=0.003, overwrite=overwrite)
    fit(photos, result, HierarchicalConfig(budget=budget), overwrite=overwrite)
    print_numbers("Map RMSE", evaluate_maps(load_maps(result), truth))
    say(f"look at {result}/report.html")
    return 0
