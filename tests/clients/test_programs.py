"""Exports, opened in the programs they are for: what these show is what our renderer shows."""

import pytest
from clients.programs import CLIENTS, compared, exported, truth
from helpers.exported import gilt_plates

from mitsvbrdf.material.made import make_material

RMSE, MEANS = 0.02, 0.1  # in display values; each channel's mean, relative

# Of a client that cannot show all of it, what it was measured to miss by, at most.
LIMITED = {"three.js, USD": (0.16, 0.6), "Blender, maps": (0.05, 0.12)}


@pytest.fixture(scope="module", params=["gilt plates", "inlay"])
def material(request, tmp_path_factory):
    """Metal, dielectric, colours and F0 below 0.04."""
    made = gilt_plates(128) if request.param == "gilt plates" else make_material("inlay", 128)
    return exported(made, tmp_path_factory.mktemp("exported")), made


@pytest.mark.slow
@pytest.mark.parametrize("client", CLIENTS)
def test_clients_show_the_material(client, material, two_threads):
    folder, made = material
    found = compared(CLIENTS[client](folder, made.resolution), truth(made))
    rmse, means = LIMITED.get(client, (RMSE, MEANS))
    assert max(found["rmse"]) <= rmse, found
    assert all(abs(mean - 1) <= means for light in found["means"] for mean in light), found
    if client == "Mitsuba, scene.xml":
        assert max(found["rmse"]) < 1e-4


@pytest.mark.slow
def test_clients_are_told_apart_from_a_wrong_material(material):
    """The limit is not met by a picture of the material with its highlights a quarter as strong."""
    _, made = material
    dimmer = type(made)(made.bsdf, dict(made.maps) | {"specular": made["specular"] / 4})
    assert max(compared(truth(dimmer), truth(made))["rmse"]) > 2 * RMSE

