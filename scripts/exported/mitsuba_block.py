"""Renders the block of a job in Mitsuba 3, lit by an exported module.

    python mitsuba_block.py JOB.json

Knows nothing of torchlight: the job names vertices and faces, the module's folder, and the picture to write.
"""

# pyright: reportMissingImports=false

import json
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")


def mesh(vertices, faces, albedo):
    """Returns triangles with a Lambertian surface."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}})
    made = mi.Mesh("mesh", len(vertices), len(faces), properties)
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = np.array(vertices, dtype=np.float32).ravel()
    parameters["faces"] = np.array(faces, dtype=np.uint32).ravel()
    parameters.update()
    return made


def camera(width, pixels, samples):
    """Returns an orthographic camera over the plane: x to the right, y up."""
    place = mi.ScalarTransform4f().look_at([0.0, 0.0, 2.5 * width], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    film = {"type": "hdrfilm", "width": pixels, "height": pixels, "component_format": "float32"}
    return {
        "type": "orthographic",
        "to_world": place.scale([width / 2, width / 2, 1.0]),
        "film": {**film, "pixel_format": "rgb", "rfilter": {"type": "box"}},
        "sampler": {"type": "multijitter", "sample_count": samples},
    }


def from_xml(path):
    """Returns everything that shines in the exported XML: the empty plane is lit by it."""
    scene = mi.load_file(str(path))
    return {"environment": scene.environment(), **{shape.id(): shape for shape in scene.shapes()}}


def main(job):
    """Writes every picture of a job."""
    sys.path.insert(0, job["folder"])
    from light_mitsuba import LAMPS, emitters, lamp

    half = job["width"] / 2
    corners = [(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)]
    for shot in job["shots"]:
        shining = emitters() if shot["block"] else from_xml(Path(job["folder"]) / "light_mitsuba.xml")
        if not shot["picture"]:  # then there is nothing behind a lamp that it would hide
            shining = {str(i): lamp(*LAMPS[i - 1][:3], (0.0, 0.0, 0.0), 1000.0) for i in shot["lamps"]}
        scene = {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": camera(job["width"], job["pixels"], job["samples"]),
            "plane": mesh(corners, [(0, 1, 2), (0, 2, 3)], 1.0),
            **shining,
        }
        if shot["block"]:
            scene["block"] = mesh(job["vertices"], job["faces"], 0.0)
        mi.util.write_bitmap(shot["out"], mi.render(mi.load_dict(scene), seed=1), write_async=False)
    print("version", mi.__version__)


main(json.loads(Path(sys.argv[-1]).read_text()))
