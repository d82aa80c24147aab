"""Materials of MaterialX documents as libraries serve them, their values by the specification's formulas."""

import os
import threading

import numpy as np
import pytest
from PIL import Image

from mitsvbrdf.errors import AssumedWarning, MapsError
from mitsvbrdf.export import export_material
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps
from mitsvbrdf.material.maps import flat
from mitsvbrdf.material.naming import SURFACES

FILES = {"c": (188, 128, 64), "orm": (9, 128, 64), "n": (128, 166, 249), "grey": 51}


def srgb(level):
    return ((level / 255 + 0.055) / 1.055) ** 2.4


def document(folder, shader, inputs, nodes="", about='version="1.38" colorspace="lin_rec709"'):
    (folder / "tex").mkdir(parents=True)
    for name, value in FILES.items():
        Image.fromarray(np.full((8, 8, 3), value, np.uint8)).save(folder / f"tex/{name}.png")
    text = (f'<?xml version="1.0"?><materialx {about}>{nodes}<{shader} name="S" type="surfaceshader">{inputs}'
            f'</{shader}><surfacematerial name="M" type="material"><input name="surfaceshader" '
            f'type="surfaceshader" nodename="S"/></surfacematerial></materialx>')
    (folder / "m.mtlx").write_text(text)
    return folder


def image(name, kind="color3", node="tiledimage", more="", space='colorspace="srgb_texture"'):
    return (f'<{node} name="{name}" type="{kind}"><input name="file" type="filename" value="tex/{name}.png" '
            f'{space if "color" in kind else ""}/>{more}</{node}>')


def wired(name, node, more=""):
    return f'<input name="{name}" type="color3" nodename="{node}" {more}/>'


def valued(name, value, kind="float"):
    return f'<input name="{name}" type="{kind}" value="{value}"/>'


NORMAL = image("n", "vector3") + ('<normalmap name="nm" type="vector3"><input name="in" nodename="n"/>{}'
                                  '</normalmap>')
GRAPH = (f'<nodegraph name="G" fileprefix="tex/">{NORMAL.format("")}{image("c")}{image("orm", "vector3")}'
         '<separate3 name="s" type="multioutput"><input name="in" nodename="orm"/></separate3>'
         '<output name="base" nodename="c"/><output name="nrm" nodename="nm"/>'
         '<output name="r" nodename="s" output="outy"/><output name="m" nodename="orm" channels="z"/>'
         '</nodegraph>').replace("tex/c.", "c.").replace("tex/n.", "n.").replace("tex/orm.", "orm.")


def of_graph(name, output):
    return f'<input name="{name}" nodegraph="G" output="{output}"/>'


@pytest.mark.filterwarnings("ignore::mitsvbrdf.errors.AssumedWarning")
@pytest.mark.parametrize("surface", SURFACES)
def test_a_graph_is_followed_to_files_and_channels(surface, tmp_path):
    names = SURFACES[surface]
    found = load_maps(document(tmp_path / "a", surface, "".join(
        of_graph(names[ours][0], output) for ours, output in
        (("base_color", "base"), ("roughness", "r"), ("metallic", "m"), ("normal", "nrm"))), GRAPH))
    assert found.bsdf == "principled"  # F0 of the index 1.5 is 0.04
    assert found["base_color"][0, 0].tolist() == pytest.approx([srgb(x) for x in FILES["c"]], abs=1e-6)
    assert found["roughness"][0, 0, 0] == pytest.approx(128 / 255)
    assert found["metallic"][0, 0, 0] == pytest.approx(64 / 255)
    normal = np.array(FILES["n"]) / 255 * 2 - 1
    assert found["normal"][0, 0].numpy() == pytest.approx(normal / np.linalg.norm(normal), abs=1e-6)


def test_defaults_are_those_of_the_libraries():
    mx = pytest.importorskip("MaterialX", reason="needs MaterialX, of the test extra")
    library = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    absent = {"gltf_pbr": {"weight"}, "UsdPreviewSurface": {"weight", "level", "specular_color"}}
    for surface, names in SURFACES.items():
        (node,) = [each for each in library.getMatchingNodeDefs(surface) if each.getDefaultVersion()
                   or len(library.getMatchingNodeDefs(surface)) == 1]
        for ours, (name, default) in names.items():
            entry = node.getActiveInput(name)
            assert (entry is None) == (ours in absent.get(surface, set())), (surface, name)
            if entry is not None and ours != "normal":
                assert {float(x) for x in entry.getValueString().split(",")} == {default}, (surface, name)


@pytest.mark.parametrize("inputs, f0, taken", [
    (valued("specular_IOR", 2), 1 / 9, 1 / 9), (valued("specular", 0.5), 0.02, 0.02),
    (valued("specular_color", "0.5, 1, 1", "color3"), 0.02, 0.04), (wired("specular_color", "c"),
                                                                    0.04 * srgb(188), 0.04)])
def test_f0_is_a_product_and_the_base_gets_what_the_highlight_leaves(inputs, f0, taken, tmp_path):
    """Standard Surface: the base is weighed by 1 - weight * F, without the highlight's colour."""
    with pytest.warns(AssumedWarning):
        found = load_maps(document(tmp_path / "a", "standard_surface", valued("base", 0.5) + valued(
            "base_color", "0.5, 0.5, 0.5", "color3") + inputs, image("c")))
    assert found["specular"][0, 0, 0] == pytest.approx(f0, rel=1e-4)
    assert found["diffuse"][0, 0, 0] == pytest.approx(0.25 * (1 - taken), rel=1e-4)
    assert found["roughness"][0, 0, 0] == pytest.approx(0.2) and found["normal"][0, 0, 2] == 1


@pytest.mark.parametrize("nodes, base", [
    (image("c", space=""), 188 / 255), (image("c", space='colorspace="g22_rec709"'), (188 / 255) ** 2.2),
    (image("c") + '<multiply name="x" type="color3"><input name="in1" nodename="c"/>'
     + valued("in2", 0.5) + "</multiply>", srgb(188) / 2),
    (image("grey", "float") + '<convert name="x" type="color3"><input name="in" nodename="grey"/></convert>',
     0.2), (image("c", "color3", "gltf_image", valued("factor", "0.25, 1, 1", "color3")), srgb(188) / 4),
    (image("orm", "vector3") + '<extract name="x" type="float"><input name="in" nodename="orm"/>'
     + valued("index", 1, "integer") + "</extract>", 128 / 255),
    ('<constant name="x" type="color3"><input name="value" type="color3" value="0.5, 0.5, 0.5" '
     'colorspace="srgb_texture"/></constant>', ((0.5 + 0.055) / 1.055) ** 2.4)])
def test_colour_spaces_factors_and_channels(nodes, base, tmp_path):
    with pytest.warns(AssumedWarning):
        found = load_maps(document(tmp_path / "a", "gltf_pbr", wired(
            "base_color", "x" if '"x"' in nodes else "c") + valued("metallic", 0), nodes))
    assert found["base_color"][0, 0, 0] == pytest.approx(base, rel=1e-5)


@pytest.mark.parametrize("scale, sign", [("", 1), (valued("scale", "1.0, -1.0", "vector2"), -1)])
def test_a_negative_scale_of_y_is_directx(scale, sign, tmp_path):
    with pytest.warns(AssumedWarning):
        found = load_maps(document(tmp_path / "a", "gltf_pbr", wired("normal", "nm"), NORMAL.format(scale)))
    assert found["normal"][0, 0, 1] * sign == pytest.approx((166 / 255 * 2 - 1) / np.linalg.norm(
        np.array(FILES["n"]) / 255 * 2 - 1), abs=1e-6)


@pytest.mark.parametrize("inputs, nodes, said", [
    (valued("coat", 0.5) + valued("sheen", 0) + valued("opacity", "1,1,1"), "", "passed over coat; --enc"),
    (wired("base_color", "c"), image("c", more=valued("uvtiling", "3, 3")), "passed over uvtiling 3, 3"),
    (wired("base_color", "c"), image("c", more='<input name="texcoord" nodename="t"/>')
     + '<place2d name="t" type="vector2"/>', "passed over texcoord t"),
    (wired("normal", "nm"), NORMAL.format("").replace('n.png', 'n_NormalDX.png'),
     "despite their name; --normal dx")])
def test_what_a_material_does_not_have_is_said(inputs, nodes, said, tmp_path):
    folder = document(tmp_path / "a", "standard_surface", inputs, nodes)
    (folder / "tex/n_NormalDX.png").write_bytes((folder / "tex/n.png").read_bytes())
    with pytest.warns(AssumedWarning, match=said):
        load_maps(folder)


PRODUCT = ('<multiply name="x" type="color3"><input name="in1" nodename="c"/>'
           '<input name="in2" nodename="orm"/></multiply>')


@pytest.mark.parametrize("inputs, nodes, word", [
    (wired("base_color", "x"), image("c") + image("orm") + PRODUCT, "two images, c.png and orm.png"),
    (wired("base_color", "x"), '<remap name="x" type="color3"/>', "remap 'x' between"),
    (wired("base_color", "no"), "", "no node 'no'"),
    (wired("base_color", "c"), image("c").replace("png", "EXR"), "an EXR in srgb"),
    (wired("base_color", "x"), '<dot name="x"><input name="in" nodename="x"/></dot>', "recursion"),
    (wired("base_color", "c"), image("c", space='colorspace="acescg"'), "acescg"),
    (wired("base_color", "c") + wired("specular_color", "orm"),
     image("c", more=valued("uvtiling", "3, 3")) + image("orm"), "placed alike"),
    (wired("base_color", "c") + wired("specular_color", "d"), image("c", more=valued("uvtiling", "3, 3"))
     + image("c").replace('name="c"', 'name="d"'), "c.png at two places"),
    (wired("normal", "nm"), NORMAL.format(valued("scale", 0.5)), "normalmap 'nm' with a scale"),
    (wired("base_color", "c"), image("c").replace("tex/", "../"), "beside the file"),
    (wired("base_color", "c"), image("c").replace("tex/c", "tex/d"), "no file at"),
    (valued("specular_IOR", "x"), "", "float"), (valued("specular_IOR", -1), "", "zero"),
    ("", '<surfacematerial name="N"><input name="surfaceshader" nodename="S"/></surfacematerial>',
     "2 materials")])
def test_what_cannot_be_read_is_one_error(inputs, nodes, word, tmp_path):
    with pytest.raises(MapsError, match=word):
        load_maps(document(tmp_path / "a", "standard_surface", inputs, nodes) / "m.mtlx")


def test_entities_are_refused(tmp_path):
    (tmp_path / "m.mtlx").write_text('<!DOCTYPE a [<!ENTITY b "c">]><materialx/>')
    with pytest.raises(MapsError, match="DOCTYPE"):
        load_maps(tmp_path / "m.mtlx")


def test_a_document_that_is_not_understood_gives_way_to_names_and_says_so(tmp_path):
    folder = document(tmp_path / "a", "standard_surface", wired("base_color", "x"), '<remap name="x"/>')
    for name, file in {"w_Color": "c", "w_Roughness": "grey", "w_NormalGL": "n"}.items():
        (folder / f"{name}.png").write_bytes((folder / f"tex/{file}.png").read_bytes())
    with pytest.warns(AssumedWarning, match="by the names of the files, without the document.*remap 'x'"):
        assert load_maps(folder)["roughness"][0, 0, 0] == pytest.approx(0.2)


@pytest.mark.filterwarnings("ignore::mitsvbrdf.errors.AssumedWarning")
@pytest.mark.parametrize("file", ["material.mtlx", "openpbr.mtlx", ""])
@pytest.mark.parametrize("made", [make_material("plates", 32), flat(8, "principled", metallic=0.2)],
                         ids=["roughconductor", "principled"])
def test_our_own_documents_are_read_back_within_their_bits(made, file, tmp_path):
    export_material(made, tmp_path / "a", ["materialx"])
    found = load_maps(tmp_path / "a/materialx" / file)
    assert found.bsdf == made.bsdf
    for name, value in made.maps.items():
        assert (found[name] - value).abs().max() < 3e-5, name  # a step of 16 bits, doubled in normals
    export_material(found, tmp_path / "b", ["materialx"])
    for path in (tmp_path / "a/materialx/textures").iterdir():
        first, again = (np.asarray(Image.open(tmp_path / side / "materialx/textures" / path.name)).astype(int)
                        for side in "ab")
        assert np.abs(first - again).max() <= 1, path.name


def test_a_pipe_is_not_waited_for(tmp_path):
    pipe = tmp_path / "material.mtlx"
    os.mkfifo(pipe)
    # whoever does wait for it is not left waiting
    threading.Thread(target=lambda: [pipe.write_bytes(b"") for _ in range(9)], daemon=True).start()
    with pytest.raises(MapsError, match="regular file"):
        load_maps(tmp_path)
