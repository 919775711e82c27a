"""Renders the block of a job in Blender (bpy or `blender --background --python`), lit by an exported script.

    python blender_block.py JOB.json

Knows nothing of torchlight: the job names vertices and faces, the folder of the exported script, and the pictures to
write.
"""

# pyright: reportMissingImports=false

import json
import sys
from pathlib import Path

import bpy


def material(name, albedo):
    """Returns a Lambertian surface."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    surface, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    surface.inputs["Color"].default_value = (albedo, albedo, albedo, 1.0)
    links.new(surface.outputs["BSDF"], output.inputs["Surface"])
    return made


def add(scene, name, vertices, faces, albedo):
    """Adds a mesh."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    mesh.materials.append(material(name, albedo))
    scene.collection.objects.link(bpy.data.objects.new(name, mesh))


def look_down(scene, width, pixels):
    """Adds an orthographic camera over the plane: x to the right, y up."""
    camera = bpy.data.cameras.new("above")
    camera.type, camera.ortho_scale = "ORTHO", width
    placed = bpy.data.objects.new("above", camera)
    placed.location = (0.0, 0.0, 2.5 * width)
    scene.collection.objects.link(placed)
    scene.camera = placed
    scene.render.resolution_x = scene.render.resolution_y = pixels
    scene.render.resolution_percentage = 100


def settings(scene, samples):
    """Path tracing without denoising, clamping or a view transform; 32-bit EXR."""
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = samples
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = 0.0
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 1.0
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.image_settings.color_depth = "32"


def light_by(script, picture_on, lamps):
    """Runs the exported script, then leaves out the picture or lamps that a job does not want."""
    exec(compile(script.read_text(), str(script), "exec"), {"__name__": "__main__", "__file__": str(script)})
    if not picture_on:
        bpy.context.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    for placed in [it for it in bpy.context.scene.objects if it.type == "LIGHT"]:
        if lamps is not None and int(placed.name.split()[-1]) not in lamps:
            bpy.data.objects.remove(placed)


def main(job):
    """Writes every picture of a job."""
    for shot in job["shots"]:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        half = job["width"] / 2
        corners = [(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)]
        add(scene, "plane", corners, [(0, 1, 2, 3)], 1.0)
        if shot["block"]:
            add(scene, "block", job["vertices"], job["faces"], 0.0)
        look_down(scene, job["width"], job["pixels"])
        settings(scene, job["samples"])
        light_by(Path(job["folder"]) / "light_blender.py", shot["picture"], shot["lamps"])
        scene.render.filepath = shot["out"]
        bpy.ops.render.render(write_still=True)
    print("version", bpy.app.version_string)


main(json.loads(Path(sys.argv[-1]).read_text()))
