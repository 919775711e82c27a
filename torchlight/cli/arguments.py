"""The commands and their options, as dataclasses that tyro turns into `torchlight <command>`.

Nothing heavy is imported here: `--help` answers without torch.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import arg

from torchlight import config as tree

Settings = Annotated[tree.Config, tyro.conf.FlagConversionOff, arg(name="")]  # switches take a value: cli.spelling
Convention = Literal["torchlight", "blender", "openexr", "usd", "mitsuba", "skylibs", "threejs"]
Program = Literal["blender", "mitsuba", "openexr", "usd", "threejs", "skylibs"]
Kind = Literal[
    "torchlight",
    "blender",
    "openexr",
    "usd",
    "mitsuba",
    "skylibs",
    "threejs",
    "cross",
    "horizontal-cross",
    "strip",
    "opengl-strip",
    "angular",
]


@dataclass(frozen=True)
class Estimate:
    """Recover the light from photographs of a scene: OUT/<photo's stem>/light.exr and the evidence beside it.

    Exit code: 0 all done, 1 some photographs failed (the others are complete), 2 nothing could start.
    """

    scene: Annotated[Path, tyro.conf.Positional, arg(metavar="SCENE")]
    """Scene file (YAML); see docs/scenes.md."""
    photos: Annotated[tuple[Path, ...], tyro.conf.Positional, arg(metavar="PHOTO [PHOTO ...]")]
    """Photographs of that scene: PNG, JPEG, TIFF, EXR or HDR."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder that receives one folder per photograph."""
    overwrite: bool = False
    """Replace existing results."""
    config: Annotated[Path | None, arg(metavar="FILE")] = None
    """Settings (YAML), as torchlight config show prints them; options given beside it count."""
    settings: Settings = tree.DEFAULTS


@dataclass(frozen=True)
class Batch:
    """Recover the light from thousands of photographs; run it again and it goes on where it stopped.

    Writes OUT/photos/<name>/ per photograph as estimate does, OUT/results.csv and OUT/results.jsonl. See docs/batch.md.
    Exit code: 0 all done, 1 some failed (the others are complete) or are pending, 2 nothing could start.
    """

    sources: Annotated[tuple[str, ...], tyro.conf.Positional, arg(metavar="MANIFEST|PHOTO [PHOTO ...]")] = ()
    """A manifest (.jsonl or .csv) that names photographs with their scenes, or photographs and patterns such as
    'photos/*.jpg' (quoted)."""
    out: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder of the results."""
    scene: Annotated[Path | None, arg(metavar="SCENE")] = None
    """Scene file of the photographs that name none."""
    workers: int | None = None
    """Processes, each of one thread; 0 = in this process. Default: one per processor."""
    shard: Annotated[str, arg(metavar="i/n")] = "1/1"
    """Do the i-th of n parts, counted from 1; other machines do the others, into the same folder."""
    retry_failed: bool = False
    """Do photographs that failed before again."""
    engine: Literal["local", "ray"] = "local"
    """local: processes of this machine. ray: a Ray cluster (extra cluster)."""
    address: Annotated[str | None, arg(metavar="HOST:PORT")] = None
    """Of the Ray cluster; default: one on this machine, of --workers workers."""
    merge: Annotated[Path | None, arg(metavar="DIR")] = None
    """Do nothing but write the tables of DIR, whose shards have ended or are at work."""
    parquet: bool = False
    """Write results.parquet beside results.csv (extra parquet): columns with types."""
    config: Annotated[Path | None, arg(metavar="FILE")] = None
    """Settings (YAML), as torchlight config show prints them; options given beside it count."""
    settings: Settings = tree.DEFAULTS


@dataclass(frozen=True)
class Sweep:
    """Try settings by grid, at random or with Optuna, and say which find the light best; run again, it goes on.

    Writes OUT/trials/<name>/trial.json per trial, OUT/results.csv and OUT/results.jsonl, OUT/plots. See docs/sweeps.md.
    Exit code: 0 all done, 1 some trials failed (the others are complete), 2 nothing could start.
    """

    sweep: Annotated[Path, tyro.conf.Positional, arg(metavar="SWEEP.yaml")]
    """What is tried, and on which photographs; configs/sweeps holds some."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder of the results."""
    data: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder that the file's lights are relative to. Default: that of the file."""
    workers: int | None = None
    """Processes, each of one thread; 0 = in this process. Default: one per processor."""
    retry_failed: bool = False
    """Do trials that failed before again."""
    tensorboard: bool = False
    """Write OUT/tensorboard/<name> per trial too (extra tensorboard)."""
    engine: Literal["local", "ray"] = "local"
    """local: processes of this machine. ray: a Ray cluster (extra cluster)."""
    address: Annotated[str | None, arg(metavar="HOST:PORT")] = None
    """Of the Ray cluster; default: one on this machine, of --workers workers."""


@dataclass(frozen=True)
class Config:
    """Print every setting with its value, as YAML that --config reads."""

    action: Annotated[Literal["show"], tyro.conf.Positional]
    """What to do."""
    config: Annotated[Path | None, arg(metavar="FILE")] = None
    """Settings (YAML) to start from."""
    settings: Settings = tree.DEFAULTS


@dataclass(frozen=True)
class Analyze:
    """Say before any photograph is taken how fine a light the scene's shadows determine, and in which directions.

    Several scenes are analysed one by one and together, as photographs of one light. Prints a verdict of three lines
    each and writes analysis.json, figures and an observability map; see docs/analysis.md.
    """

    scenes: Annotated[tuple[Path, ...], tyro.conf.Positional, arg(metavar="SCENE [SCENE ...]")]
    """Scene files (YAML)."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder that receives the results."""
    noise: float = 0.01
    """Standard deviation of the noise per sample, as a share of the brightest sample."""
    bandwidth_max: int = 12
    """Largest bandwidth B of the nullity curves; B means degrees l < B."""
    rotations: int = 300
    """Random turns of the sampling directions over which nullity is averaged."""
    seed: int = 0
    """Seed of these turns."""
    overwrite: bool = False
    """Replace an existing analysis."""
    no_cache: bool = False
    """Neither read nor write the scenes' transports on disk."""


@dataclass(frozen=True)
class Render:
    """Render the scene's receiver under a light: the rectified plane, or the camera's view where the scene has one.

    The values are albedo x irradiance / pi (albedo 1 where the scene gives none). In the camera's view occluders are
    black and everything beyond the receiver is transparent.
    """

    scene: Annotated[Path, tyro.conf.Positional, arg(metavar="SCENE")]
    """Scene file (YAML)."""
    light: Annotated[Path, tyro.conf.Positional, arg(metavar="LIGHT")]
    """EXR or HDR: a lat-long, a cube cross or strip, or an angular map; harmonics as JSON."""
    out: Annotated[Path, arg(metavar="IMAGE")]
    """Picture to write: .exr (linear, mask beside it) or .png (8-bit, encoded as the scene says, sRGB by default)."""
    convention: Convention | None = None
    """Axes of a lat-long light; default: what its metadata says, else torchlight's."""
    exposure: float = 1.0
    """Factor applied before writing."""
    rays: int = 16384
    """Directions the light is cut into."""
    overwrite: bool = False
    """Replace an existing picture."""


@dataclass(frozen=True)
class Insert:
    """Put an object into a photograph, lit by the light recovered from it; its shadow falls on the plane.

    The object rests on the plane at --position unless --pose says otherwise. Light counts that comes straight from the
    sky: neither what object and plane throw on each other (but see --bounce), nor light from below. Where the scene
    states no albedo of the plane, --albedo is relative to it: 1 is as bright as the plane. See docs/insertion.md.
    """

    photo: Annotated[Path, tyro.conf.Positional, arg(metavar="PHOTO")]
    """Photograph of the scene: PNG, JPEG, TIFF, EXR, HDR or RAW."""
    scene: Annotated[Path, arg(metavar="SCENE")]
    """Scene file (YAML): what stands there, the receiver, the camera."""
    light: Annotated[Path, arg(metavar="LIGHT")]
    """The light.exr that was recovered from this photograph, or any EXR or HDR in the same units."""
    object: Annotated[Path, arg(metavar="MESH")]
    """What to insert: .obj, .ply, .stl, .off, .glb or .gltf."""
    out: Annotated[Path, arg(metavar="IMAGE")]
    """Picture to write: .png or .jpg in the photograph's own encoding, or .exr (linear)."""
    layer: Literal["composite", "straight", "premultiplied", "all"] = "composite"
    """composite: the finished picture. straight, premultiplied: object and shadow as a layer with alpha, to be put over
    the photograph in linear light; premultiplied is an .exr. all: the three, OUT_straight and OUT_premultiplied.exr
    beside OUT."""
    position: Annotated[tuple[float, float], arg(metavar="X Y")] = (0.0, 0.0)
    """Where the middle of the object's bounding box stands, in the scene's unit."""
    rotate: Annotated[float, arg(metavar="DEGREES")] = 0.0
    """Turn about the plane's normal, counter-clockwise from above."""
    up: Literal["x", "y", "z"] = "z"
    """Axis of the mesh that points up; y for many."""
    scale: float = 1.0
    """Factor from the mesh's numbers to the scene's unit."""
    units: Literal["mm", "cm", "m", "inch"] | None = None
    """Unit of the mesh, converted to the scene's; instead of, or on top of, --scale."""
    pose: Annotated[str | None, arg(metavar="16 NUMBERS")] = None
    """Mesh to world as a 4 x 4 matrix, row by row, separated by commas; instead of the five above."""
    albedo: Annotated[tuple[float, float, float], arg(metavar="R G B")] = (0.6, 0.6, 0.6)
    """Of the object's diffuse part, linear."""
    gloss: float = 0.0
    """Share of light that the glossy lobe (GGX) throws back, 0 to 1; the diffuse part keeps 1 - GLOSS of its albedo."""
    roughness: float = 0.3
    """Of the lobe: 0.1 is shiny, 0.5 is satin."""
    bounce: bool = False
    """Let the plane throw light back on the object, once."""
    only_receiver: bool = False
    """Let the plane, and the shadow, end where the scene's receiver does. Default: the plane goes on."""
    fit_brightness: bool = False
    """Scale the light, per channel, to what the photograph shows of the plane; done unasked where the scene has a
    reference."""
    as_found: bool = False
    """Use LIGHT as it is. Default: a light whose file says that it was recovered from this photograph is made even
    where the photograph does not tell, since objects show what the plane does not."""
    convention: Convention | None = None
    """Axes of a lat-long light; default: what its metadata says, else torchlight's."""
    rays: int = 8192
    """Directions the light is cut into."""
    overwrite: bool = False
    """Replace existing pictures."""


@dataclass(frozen=True)
class Relight:
    """Turn a photograph into what it would be under another light, or without the shadows on its plane.

    Pixels of the plane are multiplied by the ratio of the irradiances; so are those of the objects, taken as diffuse.
    To render a scene without a photograph: torchlight render.
    """

    scene: Annotated[Path, tyro.conf.Positional, arg(metavar="SCENE")]
    """Scene file (YAML)."""
    light: Annotated[Path, tyro.conf.Positional, arg(metavar="LIGHT")]
    """The new light; with --remove-shadow the light of the photograph. EXR or HDR."""
    photo: Annotated[Path, arg(metavar="PHOTO")]
    """Photograph of the scene."""
    out: Annotated[Path, arg(metavar="IMAGE")]
    """Picture to write: .png or .jpg in the photograph's own encoding, or .exr (linear)."""
    from_light: Annotated[Path | None, arg(name="from", metavar="OLD_LIGHT")] = None
    """The light of the photograph, such as the light.exr that was recovered from it."""
    remove_shadow: bool = False
    """Show the plane as it would be without the objects on it."""
    hole: Literal["fill", "transparent", "keep"] = "fill"
    """Of --remove-shadow, the objects' own pixels. fill: the plane is continued smoothly over them. transparent: alpha
    0. keep: as photographed."""
    gain: float = 8.0
    """A pixel is brightened at most so many times, beyond what the lights differ by on the whole."""
    exposure: float = 1.0
    """Factor applied before writing."""
    convention: Convention | None = None
    """Axes of lat-long lights; default: what their metadata say, else torchlight's."""
    rays: int = 8192
    """Directions each light is cut into."""
    overwrite: bool = False
    """Replace an existing picture."""


@dataclass(frozen=True)
class Evaluate:
    """Compare a photograph with the scene relit by a light; JSON on standard output."""

    scene: Annotated[Path, tyro.conf.Positional, arg(metavar="SCENE")]
    """Scene file (YAML)."""
    photo: Annotated[Path, tyro.conf.Positional, arg(metavar="PHOTO")]
    """Photograph of the scene."""
    light: Annotated[Path, tyro.conf.Positional, arg(metavar="LIGHT")]
    """EXR or HDR: a lat-long, a cube cross or strip, or an angular map; harmonics as JSON."""
    convention: Convention | None = None
    """Axes of a lat-long light; default: what its metadata says, else torchlight's."""
    fit_scale: bool = False
    """Fit one factor per channel first, and print the factors."""
    rays: int = 131072
    """Directions the light is cut into."""


@dataclass(frozen=True)
class Export:
    """Hand a light to other programs: pictures in their axes, and the scripts or scene files that load them.

    Writes one folder, OUT/lamps.json in it: direction, size, colour and irradiance of the strongest lights. See
    docs/export.md.
    """

    light: Annotated[Path, tyro.conf.Positional, arg(metavar="LIGHT")]
    """EXR or HDR, or the folder of an estimate."""
    to: Annotated[tuple[Program, ...], arg(metavar="PROGRAM [PROGRAM ...]")]
    """blender, mitsuba, openexr, usd, threejs, skylibs: one or several."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder that receives the files."""
    lamps: Annotated[int, arg(metavar="K")] = 0
    """Take the K strongest lights out of the pictures and hand them over as lamps. lamps.json lists some anyway."""
    strength: float = 1.0
    """Factor that the scripts and scene files apply to all light; pictures keep their values."""
    convention: Convention | None = None
    """Axes of a lat-long LIGHT; default: what its metadata says, else torchlight's."""
    observability: Annotated[Path | None, arg(metavar="FILE|DIR")] = None
    """confidence.exr of an estimate, observability.exr of torchlight analyze, or their folder: how sure the photograph
    is of each lamp. Default: the one beside LIGHT, if there."""
    overwrite: bool = False
    """Replace an existing export."""


@dataclass(frozen=True)
class Convert:
    """Write a light as another kind of picture, larger, smaller, turned, or in other primaries; its flux is kept.

    The suffix of --out says which file: .exr, .hdr, .png (a picture to look at) or .json (spherical harmonics). See
    docs/formats.md.
    """

    light: Annotated[str, tyro.conf.Positional, arg(metavar="LIGHT|axes")]
    """EXR, HDR, or JSON of spherical harmonics; the word axes is a test map that colours every axis of the world."""
    out: Annotated[Path, arg(metavar="FILE")]
    """File to write."""
    from_: Annotated[Kind | None, arg(name="from")] = None
    """What LIGHT is. Default: what its metadata says, else its shape: 2:1 torchlight's lat-long, 3:4 cross, 6:1 strip,
    1:1 angular."""
    to: Kind | Literal["sh", "irradiance-sh"] | None = None
    """What to write. Default: torchlight's lat-long; sh for .json. irradiance-sh: convolved with the cosine."""
    size: int | None = None
    """Height of a lat-long, edge of a cube map's face, diameter of an angular map. Default: keeps the detail."""
    degree: int | None = None
    """Largest degree of spherical harmonics. Default: 8."""
    rotate: Annotated[str | None, arg(metavar="DEGREES|x:DEG,z:DEG|X,Y,Z,DEG|MATRIX")] = None
    """Turn the light counter-clockwise: about z; about the world's axes, first one first; about an axis; by nine
    numbers, row by row."""
    primaries: Literal["rec709", "rec2020", "acescg", "aces2065-1"] = "rec709"
    """Primaries of the file's colours. LIGHT's own are read from the file."""
    exposure: float = 1.0
    """Factor applied to the radiance."""
    overwrite: bool = False
    """Replace an existing file."""


@dataclass(frozen=True)
class Compare:
    """Say how far a light is from a reference: radiance, colour, directions, totals, and spheres relit by both.

    With --scene also which part of the error a photograph of that scene determines. See docs/metrics.md.
    """

    light: Annotated[Path, tyro.conf.Positional, arg(metavar="LIGHT")]
    """The light to judge; EXR or HDR: a lat-long, a cube cross or strip, or an angular map; harmonics as JSON."""
    reference: Annotated[Path, tyro.conf.Positional, arg(metavar="REFERENCE")]
    """What it is judged by; likewise."""
    scene: Annotated[Path | None, arg(metavar="SCENE")] = None
    """Scene file (YAML): split the error into what its photographs determine and the rest, and relight it with both."""
    out: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder that receives compare.json and compare.png."""
    json: bool = False
    """Print JSON instead of the table."""
    over: Literal["upper", "sphere"] = "upper"
    """What counts: upper = above the horizon, which is all that a shadow on a plane tells of; sphere = everything."""
    fit: Literal["none", "irradiance", "scale", "channels"] = "none"
    """Scale the light first. irradiance: so that the plane receives as much luminance. scale: by the factor that makes
    the RMSE smallest. channels: by one per channel that does."""
    height: int | None = None
    """Rows of the grid that both are averaged to. Default: those of the coarser map."""
    log_offset: float = 1e-3
    """Added before logarithms, as a share of the reference's mean radiance."""
    convention: Convention | None = None
    """Axes of a lat-long light; default: what its metadata says, else torchlight's."""
    reference_convention: Convention | None = None
    """Axes of a lat-long reference; likewise."""
    noise: float = 0.01
    """With --scene: standard deviation of the noise per sample, as a share of the brightest sample."""
    resolution: int = 16
    """With --scene: texels along a cube map face's edge, 2 to 32."""
    rays: int = 131072
    """With --scene: directions each light is cut into for relighting."""
    protocol: Literal["plain", "stylelight", "diffusionlight"] = "plain"
    """Of the spheres: linear radiance and plain means, or the published choices; the options below replace single
    ones."""
    tone: Literal["none", "stylelight"] | None = None
    """Curve that both maps go through before they light the spheres."""
    map_height: int | None = None
    """Rows both maps are averaged to before they light the spheres; 0 = those of the grid."""
    sphere_size: int | None = None
    """Pixels along the edge of a sphere's picture."""
    view: Annotated[tuple[float, float, float] | None, arg(metavar="X Y Z")] = None
    """From the spheres towards the viewer."""
    clip: float | None = None
    """Clip the spheres' pictures to [0, CLIP] before they are scored."""
    pixels: Literal["sphere", "image"] | None = None
    """Which pixels count: those of the sphere, or the whole picture with its black background."""
    per: Literal["value", "pixel"] | None = None
    """Divide squared errors by the number of values, or of pixels."""
    black: Literal["skip", "zero"] | None = None
    """Black pixels are left out of the spheres' RGB angle, or count as right."""
    flip: bool = False
    """Add HDR-FLIP of the maps and of the spheres (extra flip)."""
    no_cache: bool = False
    """Neither read nor write the scene's transport on disk."""
    overwrite: bool = False
    """Replace an existing comparison."""


@dataclass(frozen=True)
class Merge:
    """Merge exposure brackets of one view into a linear picture: OUT.exr, and OUT_mask.png beside it.

    Every photograph counts by its noise; pixels too bright or too dark for all of them are black in the mask. Exposures
    come from EXIF (time, aperture, ISO) unless --times states them.
    """

    photos: Annotated[tuple[Path, ...], tyro.conf.Positional, arg(metavar="PHOTO PHOTO [PHOTO ...]")]
    """Photographs of one view at two or more exposures, the camera on a stand: PNG, JPEG, TIFF, HEIC or RAW."""
    out: Annotated[Path, arg(metavar="HDR.exr")]
    """Picture to write."""
    response: Annotated[str | None, arg(metavar="estimate|srgb|linear|gamma:NUMBER|FILE")] = None
    """How stored values encode radiance; needed unless the photographs are RAW. estimate: found from the brackets and
    written to OUT_response.json (Debevec and Malik)."""
    times: Annotated[str | None, arg(metavar="T1,T2,...")] = None
    """Exposure times in seconds, such as 1/30,1/8,0.5, in the order of the photographs; instead of EXIF."""
    overwrite: bool = False
    """Replace existing files."""


@dataclass(frozen=True)
class Target:
    """Make a sheet to print: markers on all four sides, the object's footprint, a ruler; PDF, and PNG and YAML beside.

    Prints below which height of the light the object's shadow leaves the sheet, and on which markers it may fall.
    """

    out: Annotated[Path, arg(metavar="FILE.pdf")]
    """The PDF; the PNG and the YAML have the same name with another suffix."""
    paper: Literal["A4", "A3", "letter"] = "A4"
    """Page to print on, upright."""
    object: Annotated[str, arg(metavar="SHAPE:MM,...")] = "box:30,20,35"
    """What is to stand on the sheet: box:x,y,z, cylinder:radius,height or cone:radius,height."""
    pose: Annotated[str, arg(metavar="X,Y,DEGREES")] = "0,0,30"
    """Where, from the middle of the clean white, and how it is turned, counter-clockwise from above."""
    overwrite: bool = False
    """Replace existing files."""


@dataclass(frozen=True)
class Calibrate:
    """Find a camera's intrinsics and distortion from photographs of a board, and say how sure they are.

    Ten to twenty sharp photographs from several tilts are good; one, with an EXIF focal length, gives a rough start.
    Exit code: 0 all photographs were used, 1 some were left out, 2 no camera was found.
    """

    photos: Annotated[tuple[Path, ...], tyro.conf.Positional, arg(metavar="PHOTO [PHOTO ...]")]
    """Photographs of the board by one camera at one size, one zoom, one focus."""
    out: Annotated[Path, arg(metavar="FILE")]
    """camera.json, or *.yml (OpenCV), cameras.txt (COLMAP), transforms.json (Nerfstudio); a picture lies beside it."""
    target: Annotated[Path | None, arg(metavar="target.yaml")] = None
    """The board is a sheet of `torchlight target`."""
    chessboard: Annotated[str | None, arg(metavar="COLUMNSxROWS")] = None
    """The board is a chessboard: its inner corners, such as 9x6."""
    charuco: Annotated[str | None, arg(metavar="COLUMNSxROWS")] = None
    """The board is a ChArUco board: its squares, such as 5x7."""
    square: Annotated[str | None, arg(metavar="MM")] = None
    """Side of a square of the chessboard or the ChArUco board."""
    marker: Annotated[str | None, arg(metavar="MM")] = None
    """Side of a marker of the ChArUco board."""
    dictionary: str = "DICT_6X6_250"
    """Markers of the ChArUco board, by OpenCV's name."""
    ruler: Annotated[str | None, arg(metavar="MM")] = None
    """What a ruler measures along the sheet's printed line, or along a board's first row of squares, end to end; a
    print that is not to scale is refused."""
    window: int | None = None
    """Half the side of the patch that locates a chessboard's corner, in pixels. Default: a quarter of the way to the
    nearest corner, at most 11."""
    keep_all: bool = False
    """Leave out no photograph for its error."""
    overwrite: bool = False
    """Replace existing files."""


@dataclass(frozen=True)
class Joint:
    """Recover one light from several photographs of it, the object moved or turned in each: OUT/light.exr and more.

    Exposures may differ; they are given, read from EXIF, or found. Says how much each photograph added. All photographs
    must be usable: one that is not is named, and nothing is written. See docs/joint.md.
    """

    views: Annotated[Path, tyro.conf.Positional, arg(metavar="VIEWS.yaml")]
    """Which photographs, each with its scene file."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder that receives the results."""
    overwrite: bool = False
    """Replace existing results."""
    config: Annotated[Path | None, arg(metavar="FILE")] = None
    """Settings (YAML), as torchlight config show prints them; options given beside it count."""
    settings: Annotated[tree.Method, tyro.conf.FlagConversionOff, arg(name="")] = tree.METHOD_DEFAULTS


@dataclass(frozen=True)
class View:
    """Look at a scene, its light and its shadow in the browser; turn the light and see the shadow move.

    Shows the occluders, the photograph on the receiver, the camera, and the light as a dome. Ends with Ctrl-C.
    Needs the extra viewer. See docs/viewer.md.
    """

    source: Annotated[Path, tyro.conf.Positional, arg(metavar="RESULTS|SCENE")]
    """Folder of one photograph that torchlight estimate wrote (with --scene), or a scene file (YAML)."""
    scene: Annotated[Path | None, arg(metavar="SCENE")] = None
    """Scene file of the results."""
    light: Annotated[Path | None, arg(metavar="LIGHT")] = None
    """Another light: EXR or HDR. Default: that of the results; for a scene alone a built-in sky."""
    convention: Convention | None = None
    """Axes of a lat-long light; default: what its metadata says, else torchlight's."""
    host: str = "localhost"
    """Address to serve on; 0.0.0.0 lets other machines look."""
    port: int = 8080
    """Port to serve on; the next free one where it is taken."""
    resolution: int = 32
    """Texels along a cube map face's edge of the light that moves."""
    no_cache: bool = False
    """Neither read nor write the scene's transport on disk."""


@dataclass(frozen=True)
class Cache:
    """List or clear the scenes' transports kept on disk (TORCHLIGHT_CACHE names the folder)."""

    action: Annotated[Literal["list", "clear"], tyro.conf.Positional]
    """What to do."""


@dataclass(frozen=True)
class Doctor:
    """Print versions, whether Embree is there, which OpenCV wheels are installed, and the cache: for bug reports."""


@dataclass(frozen=True)
class Demo:
    """Photograph a block under a known sky, recover the sky from its shadow, and relight a second pose with it.

    Ground truth is the block's analytic shadow, which shares nothing with the solver.
    """

    out: Path = Path("demo-out")
    """Folder for the pictures; its demo files are replaced."""
    probe: Path | None = None
    """Any HDR environment (EXR or HDR) instead of the built-in sky."""
    convention: Convention | None = None
    """Axes of a lat-long probe."""


Command = (
    Annotated[Estimate, tyro.conf.subcommand("estimate")]
    | Annotated[Batch, tyro.conf.subcommand("batch")]
    | Annotated[Sweep, tyro.conf.subcommand("sweep")]
    | Annotated[Analyze, tyro.conf.subcommand("analyze")]
    | Annotated[Render, tyro.conf.subcommand("render")]
    | Annotated[Insert, tyro.conf.subcommand("insert")]
    | Annotated[Relight, tyro.conf.subcommand("relight")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Convert, tyro.conf.subcommand("convert")]
    | Annotated[Compare, tyro.conf.subcommand("compare")]
    | Annotated[Merge, tyro.conf.subcommand("merge")]
    | Annotated[Target, tyro.conf.subcommand("target")]
    | Annotated[Calibrate, tyro.conf.subcommand("calibrate")]
    | Annotated[Joint, tyro.conf.subcommand("joint")]
    | Annotated[Config, tyro.conf.subcommand("config")]
    | Annotated[View, tyro.conf.subcommand("view")]
    | Annotated[Cache, tyro.conf.subcommand("cache")]
    | Annotated[Doctor, tyro.conf.subcommand("doctor")]
    | Annotated[Demo, tyro.conf.subcommand("demo")]
)
