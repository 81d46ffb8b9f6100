"""Render what the add-on imports, with wire boxes and names of objects, for people who want to see it before they try.

    blender --background --factory-startup --python integrations/blender/picture.py -- SCENE OUT.png EYE TARGET [UP]
        [NAME...]

EYE, TARGET: x,y,z in Blender's axes. UP: of a PLY. NAME: collections that get a box and a label, all without it.
"""

import importlib.util
import sys
from pathlib import Path

import bpy
import mathutils

SIZE, SAMPLES = (960, 640), 8


def addon():
    """Load the add-on from its file, without installing it."""
    place = Path(__file__).with_name("drsplat_import.py")
    spec = importlib.util.spec_from_file_location("drsplat_import", place)
    module = importlib.util.module_from_spec(spec)
    sys.modules["drsplat_import"] = module
    spec.loader.exec_module(module)
    return module


def glowing(name, color):
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    glow, out = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    glow.inputs["Color"].default_value = (*color, 1)
    material.node_tree.links.new(glow.outputs[0], out.inputs["Surface"])
    return material


def outline(empty, camera, paint):
    """Add bars along the edges of an empty's cube and its name above it, turned to the camera."""
    bpy.ops.mesh.primitive_cube_add(size=1)
    cube = bpy.context.object
    cube.matrix_world = empty.matrix_world
    bpy.ops.object.transform_apply(location=False, rotation=False, scale=True)
    wires = cube.modifiers.new("edges", "WIREFRAME")
    wires.thickness = 0.008
    cube.data.materials.append(paint)
    corners = [cube.matrix_world @ mathutils.Vector(corner) for corner in cube.bound_box]
    text = bpy.data.curves.new(empty.name, "FONT")
    text.body, text.size, text.align_x = empty.name.removesuffix(" (box)"), 0.045, "CENTER"
    text.materials.append(paint)
    label = bpy.data.objects.new(empty.name, text)
    middle = sum(corners, mathutils.Vector()) / 8
    label.location = (middle.x, middle.y, max(corner.z for corner in corners) + 0.03)
    label.rotation_euler = camera.rotation_euler
    bpy.context.scene.collection.objects.link(label)


def main(source, target_file, eye, target, up="-Y", *names):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    whole = addon().import_file(source, up)
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.lens = 30
    camera.location = [float(number) for number in eye.split(",")]
    ahead = mathutils.Vector([float(number) for number in target.split(",")]) - camera.location
    camera.rotation_euler = ahead.to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(camera)
    scene.camera = camera
    bpy.context.view_layer.update()
    paint = glowing("outline", (1, 0.25, 0.02))
    for part in whole.children:
        if not names or part.name in names:
            for empty in [shape for shape in part.objects if shape.type == "EMPTY"]:
                outline(empty, camera, paint)
    scene.render.engine, scene.cycles.samples, scene.cycles.device = "CYCLES", SAMPLES, "CPU"
    scene.cycles.use_denoising = False
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.render.filepath = str(Path(target_file).resolve())
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main(*sys.argv[sys.argv.index("--") + 1 :])
