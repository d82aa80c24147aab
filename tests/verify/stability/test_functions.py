"""The public functions between maps and error measures make finite numbers of every sweep."""

import pytest
import torch
from helpers import TWIN
from helpers.variants import mostly_slow

from mitsvbrdf import color
from mitsvbrdf.capture import Capture, guess_diffuse
from mitsvbrdf.fit.losses import diffuse, edge_weights, photometric, tilt, total_variation
from mitsvbrdf.fit.parameters import to_raw, to_svbrdf
from mitsvbrdf.fit.start import robust_start
from mitsvbrdf.measure.metrics import image_error, map_rmse, photo_rmse
from mitsvbrdf.verify.stability import SWEEPS
from mitsvbrdf.verify.stability.conditioning import disturbed


@pytest.mark.parametrize("sweep", mostly_slow(SWEEPS, "flat"))
def test_everything_is_finite(sweep):
    for case in SWEEPS[sweep][1]():
        if case.small and not case.refused:
            radiance = TWIN.render(case.svbrdf, case.views).float()
            found = results(case.svbrdf, case.views, radiance, case.transfer or "gamma2.2")
            for name, value in found.items():
                for each in value.values() if isinstance(value, dict) else [value]:
                    assert torch.isfinite(torch.as_tensor(each)).all(), (case.label, name)


def results(svbrdf, views, radiance, transfer):
    photos, near = color.to_display(radiance, transfer), disturbed(svbrdf)
    capture = Capture(photos, views, transfer)
    guesses = {method: guess_diffuse(capture, method) for method in ("min", "mean-blur", "robust")}
    guess = guesses["min"]
    return guesses | {
        "encode": color.encode(radiance, transfer), "decode": color.decode(photos, transfer),
        "robust_start": robust_start(capture, guess, svbrdf.bsdf).maps,
        "resized, smaller": svbrdf.resized(max(1, svbrdf.resolution // 2)).maps,
        "resized, larger": svbrdf.resized(2 * svbrdf.resolution).maps,
        "to_svbrdf of to_raw": to_svbrdf(svbrdf.bsdf, to_raw(svbrdf)).maps,
        "photometric": photometric(radiance, photos, transfer), "diffuse": diffuse(svbrdf, guess),
        "total_variation": total_variation(svbrdf, edge_weights(guess)), "tilt": tilt(svbrdf),
        "map_rmse": map_rmse(near, svbrdf), "photo_rmse": photo_rmse(radiance, photos, transfer)[0],
        "image_error": image_error(radiance, radiance.double())}
