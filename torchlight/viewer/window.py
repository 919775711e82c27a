"""The window in the browser, by viser (extra `viewer`).

viser draws what is nearer than 1,000 units. All lengths are therefore divided by the dome's radius.
"""

from __future__ import annotations

import io
import logging
from contextlib import redirect_stdout
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import trimesh
from PIL import Image as Pictures
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from torchlight.errors import ConfigError
from torchlight.viewer import meshes, stage
from torchlight.viewer.meshes import Mesh
from torchlight.viewer.pictures import Image
from torchlight.viewer.stage import Stage

OCCLUDER = (150, 155, 165)
CAMERA = (40, 90, 160)
DOWNWARDS = (0.0, 1.0, 0.0, 0.0)  # viser looks along a picture's z, x to the right and y down: turned, it lies face up
STOPS = 6.0


@dataclass(frozen=True, eq=False)
class Controls:
    """The sliders and the list beside the picture; viser's handles, whose values a user changes."""

    layer: Any
    stops: Any
    degrees: Any
    dome: Any


def viser_module() -> ModuleType:
    """Returns viser; raises ConfigError where it is not installed."""
    try:
        import viser  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ConfigError("the viewer needs viser; install it: pip install 'torchlight[viewer]'") from error
    return viser


def open_window(shown: Stage, host: str, port: int) -> Any:
    """Returns a running server that shows a stage.

    Args:
        shown: what to show.
        host: address to serve on.
        port: to serve on; the next free one where it is taken.

    Raises:
        ConfigError: viser is not installed, or the address cannot be served on.
    """
    viser = viser_module()
    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # a browser that hangs up early is no error
    try:
        with redirect_stdout(io.StringIO()):  # its own greeting names no command and no scene
            server = viser.ViserServer(host=host, port=port, label="torchlight", verbose=False)
    except (OSError, OverflowError) as error:
        raise ConfigError(f"--host {host} --port {port}: cannot be served on: {error}; choose another") from error
    server.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=True)
    build(server, shown)
    return server


def close_window(server: Any) -> None:
    """Stops a server, without its own words."""
    with redirect_stdout(io.StringIO()):
        server.stop()


def build(server: Any, shown: Stage) -> Controls:
    """Puts a stage into a server's scene, and controls beside it."""
    unit = meshes.dome_radius(shown.scene)
    controls = add_controls(server.gui, shown)
    add_things(server.scene, shown, unit)
    plane = add_plane(server.scene, shown, unit)
    x, y = (value / unit for value in shown.scene.receiver.center)
    # turning the frame turns the dome, without a new picture
    light = server.scene.add_frame("/light", show_axes=False, position=(x, y, 0.0))
    add_dome(server.scene, shown, 0.0)

    def draw_plane(_: object) -> None:
        plane.image = stage.plane(shown, controls.layer.value, controls.degrees.value, controls.stops.value)

    def expose(event: object) -> None:
        add_dome(server.scene, shown, controls.stops.value)
        draw_plane(event)

    def turn(event: object) -> None:
        light.wxyz = meshes.about_z(controls.degrees.value)
        draw_plane(event)

    def hide(_: object) -> None:
        light.visible = controls.dome.value

    for control, action in ((controls.layer, draw_plane), (controls.stops, expose), (controls.degrees, turn)):
        control.on_update(action)
    controls.dome.on_update(hide)
    server.initial_camera.position = (x + 0.35, y - 1.7, 1.05)
    server.initial_camera.look_at = (x, y, 0.25)
    return controls


def add_controls(gui: Any, shown: Stage) -> Controls:
    """Adds the list, the sliders and the facts."""
    layer = gui.add_dropdown("plane shows", shown.layers, initial_value=shown.layers[0])
    stops = gui.add_slider("exposure [stops]", -STOPS, STOPS, 0.25, 0.0)
    degrees = gui.add_slider("turn light [°]", -180.0, 180.0, 1.0, 0.0, hint="about z, counter-clockwise from above")
    dome = gui.add_checkbox("light", True)
    gui.add_markdown("\n\n".join(shown.lines))
    return Controls(layer, stops, degrees, dome)


def add_things(scene: Any, shown: Stage, unit: float) -> None:
    """Adds the occluders, the camera where there is one, and the axes."""
    occluders = meshes.occluder_mesh(shown.scene.triangles)
    if len(occluders.faces):
        scene.add_mesh_simple(
            "/occluders", occluders.vertices / unit, occluders.faces, color=OCCLUDER, flat_shading=True, side="double"
        )
    if shown.scene.camera is not None:
        cone = meshes.frustum(shown.scene.camera)
        scene.add_camera_frustum(
            "/camera",
            cone.fov_radians,
            cone.aspect,
            scale=0.25,
            color=CAMERA,
            wxyz=cone.wxyz,
            position=tuple(value / unit for value in cone.position),
        )
    receiver = shown.scene.receiver
    corner = [(middle - extent / 2) / unit for middle, extent in zip(receiver.center, receiver.size, strict=True)]
    length = 0.15 * max(receiver.size) / unit
    scene.add_frame("/axes", axes_length=length, axes_radius=0.03 * length, position=(*corner, 0.0))
    for name, end in (("+x", (1.15, 0, 0)), ("+y", (0, 1.15, 0)), ("+z", (0, 0, 1.15))):
        scene.add_label(f"/axes/{name}", name, position=tuple(length * part for part in end))


def add_plane(scene: Any, shown: Stage, unit: float) -> Any:
    """Adds the receiver with its picture and returns viser's handle."""
    receiver = shown.scene.receiver
    image = stage.plane(shown, shown.layers[0], 0.0, 0.0)
    width, height, x, y = (value / unit for value in (*receiver.size, *receiver.center))
    where = {"wxyz": DOWNWARDS, "position": (x, y, 0.0)}
    return scene.add_image("/plane", image, width, height, cast_shadow=False, receive_shadow=False, **where)


def add_dome(scene: Any, shown: Stage, stops: float) -> None:
    """Adds the light as the inside of half a sphere, in place of the one before; from outside it is not there."""
    data = textured(meshes.dome_mesh(1.0), stage.dome(shown, stops))
    scene.add_glb("/light/dome", data, cast_shadow=False, receive_shadow=False)


def textured(mesh: Mesh, image: Image) -> bytes:
    """Returns a mesh that shines with a picture, as GLB: it looks the same however the window is lit."""
    material = PBRMaterial(
        emissiveTexture=Pictures.fromarray(image),
        emissiveFactor=[1.0, 1.0, 1.0],
        baseColorFactor=[0, 0, 0, 255],
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=False,
    )
    visual = TextureVisuals(uv=mesh.places.astype(np.float64), material=material)
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, visual=visual, process=False)
    data = trimesh.Scene(body).export(file_type="glb")
    if not isinstance(data, bytes):
        raise TypeError("trimesh returned no GLB")
    return data
