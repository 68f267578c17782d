"""blender_passes.py FRAME.exr: Blender opens the frame and lists every layer as a pass."""
import sys

import bpy

WANTED = {"Combined", "Alpha", "albedo", "depth", "guide_albedo", "guide_normal", "material", "material_id", "motion", "motion_prev",
          "normal", "object_id", "raw", "variance"}
image = bpy.data.images.load(sys.argv[1])
tree = bpy.data.node_groups.new("check", "CompositorNodeTree")
node = tree.nodes.new("CompositorNodeImage")
node.image = image
found = {output.name for output in node.outputs}
assert found >= WANTED, f"Blender lacks {sorted(WANTED - found)}, lists {sorted(found)}"
print("Blender", bpy.app.version_string, "lists", ", ".join(sorted(found)))
