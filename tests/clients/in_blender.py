"""Run by a Python that has ``bpy``: import a file, light it and write pictures. Arguments: one JSON object.

``file``: a GLB or USD file, or a folder of maps named as Poly Haven does; ``out``: PREFIX, for PREFIX0.exr,
...; ``size``; ``camera``; ``lights`` and ``powers`` (radiant intensity), in the patch's axes.
"""

import json
import math
import sys
from pathlib import Path

import bpy

job = json.loads(sys.argv[-1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
path = Path(job["file"])


def principled_of_maps(folder):
    """A square with the material that Node Wrangler's Principled Texture Setup makes of these files, but for
    two things: no displacement, which repeats the relief of the normals, and nothing beyond the edges.
    """
    bpy.ops.mesh.primitive_plane_add(size=1)
    material = bpy.data.materials.new("maps")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = nodes["Principled BSDF"]
    for file in sorted(folder.glob("*.png")):
        node = nodes.new("ShaderNodeTexImage")
        node.image = bpy.data.images.load(str(file))
        node.extension = "EXTEND"
        node.image.colorspace_settings.name = "sRGB" if "_diff" in file.stem else "Non-Color"
        if "_nor_gl" in file.stem:
            normal = nodes.new("ShaderNodeNormalMap")
            links.new(node.outputs["Color"], normal.inputs["Color"])
            links.new(normal.outputs["Normal"], shader.inputs["Normal"])
        else:
            names = {"_diff": "Base Color", "_metal": "Metallic", "_rough": "Roughness",
                     "_spec": "Specular IOR Level"}
            into = next((socket for end, socket in names.items() if end in file.stem), None)
            if into:
                links.new(node.outputs["Color"], shader.inputs[into])
    bpy.context.object.data.materials.append(material)


if path.is_dir():
    principled_of_maps(path)
elif path.suffix == ".glb":
    bpy.ops.import_scene.gltf(filepath=str(path))
else:
    bpy.ops.wm.usd_import(filepath=str(path))
upright = not path.is_dir()  # importers turn y up into z up: the patch then stands, facing -y


def placed(position):
    x, y, z = position
    return (x, -z, y) if upright else (x, y, z)


camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.data.angle = 2 * math.atan(0.5 / job["camera"][2])
camera.data.shift_x = 2e-5  # a ray right through the diagonal of the square may miss both triangles
camera.location = placed(job["camera"])
camera.rotation_euler = (math.pi / 2, 0, 0) if upright else (0, 0, 0)
scene.collection.objects.link(camera)
scene.camera = camera
light = bpy.data.objects.new("light", bpy.data.lights.new("light", "POINT"))
light.data.shadow_soft_size = 0
scene.collection.objects.link(light)
for other in list(bpy.data.objects):
    if other.type == "LIGHT" and other is not light:
        bpy.data.objects.remove(other)
scene.world = bpy.data.worlds.new("black")
scene.world.color = (0, 0, 0)
scene.render.engine = "CYCLES"
scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.pixel_filter_type = 1, 0, "BOX"
scene.cycles.filter_width = 0.01
scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
scene.render.resolution_x = scene.render.resolution_y = job["size"]
scene.render.film_transparent = False
scene.view_settings.view_transform = "Raw"
scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
for k, (position, power) in enumerate(zip(job["lights"], job["powers"])):
    light.location = placed(position)
    light.data.energy = 4 * math.pi * power
    scene.render.filepath = f"{job['out']}{k}.exr"
    bpy.ops.render.render(write_still=True)
