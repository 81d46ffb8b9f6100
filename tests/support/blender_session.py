"""Runs inside Blender: import a file with the add-on and print what came of it as JSON, after a marker."""

import importlib.util
import json
import sys

import bpy

addon_file, scene_file, up = sys.argv[sys.argv.index("--") + 1 :]
spec = importlib.util.spec_from_file_location("drsplat_import", addon_file)
addon = importlib.util.module_from_spec(spec)
sys.modules["drsplat_import"] = addon
spec.loader.exec_module(addon)
addon.register()
assert bpy.ops.import_scene.drsplat(filepath=scene_file, up=up) == {"FINISHED"}
bpy.context.view_layer.update()


def described(shape):
    facts = {
        "type": shape.type,
        "matrix": [list(row) for row in shape.matrix_world],
        "parent": shape.parent is not None,
    }
    if shape.type == "MESH":
        facts["world"] = [list(shape.matrix_world @ vertex.co) for vertex in shape.data.vertices]
        for attribute in shape.data.attributes:
            slot = {"FLOAT_VECTOR": "vector", "FLOAT_COLOR": "color"}.get(attribute.data_type, "value")
            values = [getattr(item, slot) for item in attribute.data]
            facts[attribute.name] = [list(value) if hasattr(value, "__len__") else value for value in values]
        shown = shape.evaluated_get(bpy.context.evaluated_depsgraph_get())
        facts["instances"] = sum(
            one.is_instance and one.parent == shown for one in bpy.context.evaluated_depsgraph_get().object_instances
        )
    return facts


whole = bpy.context.scene.collection.children[-1]
parts = {part.name: {shape.name: described(shape) for shape in part.objects} for part in whole.children}
addon.unregister()
print("RESULT" + json.dumps({"name": whole.name, "parts": parts}))
