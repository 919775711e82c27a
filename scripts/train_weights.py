"""Trains a small network through the solve: which samples of a dirty plane may be believed.

    python scripts/train_weights.py --out docs/images

Training pairs are made by one linear operator (`tl.relight_by`): a random light, the photograph of a block with stains
on the plane, and the same light's shadow of another block. The network sees a photograph and what the light of a first
solve cannot explain of it, and says how much every sample counts in a second solve (`tl.solve`); the loss is what that
light does to the other block. Held out are lights and stains of another kind that no training pair had, cast by rays
(`tl.relight`). Prints the gain and draws OUT/training.png. Takes half a minute of processor time.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch import Tensor

import torchlight as tl
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.receiver import sample_centers
from torchlight.inversion.robust import robust_weights
from torchlight.metrics import rms_255
from torchlight.synthetic import block_scene, eight_bit

SIDE = 24  # samples
RECEIVER = tl.Receiver((0.0, 0.0), (4.0, 4.0), (SIDE, SIDE))
SHOWN = block_scene(Block((1.0, 0.6, 1.2), 20.0), RECEIVER)
OTHER = block_scene(Block((0.7, 0.7, 1.6), 50.0, (-0.2, -0.3)), RECEIVER)
RESOLUTION, FINER = 8, 16  # texels along an edge of what is solved for, and of what photographs are made with
SOLVER = tl.NNLS(ridge=1e-3)
NOISE = 0.005  # of the brightest sample
HELD_OUT, RAYS = 12, 8_192
ROUNDS = 5  # of Huber's weights


@dataclass(frozen=True, eq=False)
class Pairs:
    """Photographs and what another pose shows under the same light.

    Attributes:
        seen: irradiance samples with stains, noise and 8 bits, the brightest about 1 [pairs 3 points].
        other: of the other block, exact, in the same unit.
        clean: samples without a stain [pairs points].
    """

    seen: Tensor
    other: Tensor
    clean: Tensor


def main(out: Path, steps: int = 60, photographs: int = 12, seed: int = 0) -> None:
    """Trains, prints what that brought, and draws.

    Args:
        out: folder for training.png.
        steps: of the optimizer.
        photographs: pairs per step, new ones each time.
        seed: of lights, stains, noise and the network.
    """
    begun = time.perf_counter()
    torch.manual_seed(seed)
    matrices = [tl.precompute(scene, RESOLUTION, use_cache=False).transport for scene in (SHOWN, OTHER)]
    makers = [tl.precompute(scene, FINER, use_cache=False) for scene in (SHOWN, OTHER)]
    visible = visible_samples(SHOWN).float()
    network = weigher()
    optimizer = torch.optim.Adam(network.parameters(), lr=5e-3)
    for step in range(steps):
        lights = random_lights(photographs)
        truth = [tl.relight_by(maker, scene, lights) for maker, scene in zip(makers, (SHOWN, OTHER), strict=True)]
        pairs = photographed(truth[0], truth[1], discs(photographs), visible)
        loss = (relit(matrices, pairs.seen, weights(network, matrices[0], pairs.seen, visible)) - pairs.other).square()
        optimizer.zero_grad()
        loss.mean().backward()
        optimizer.step()
        if step % (steps // 4) == 0:
            print(f"step {step}: RMS of the pairs' other pose {255 * loss.mean().sqrt().item():.2f} of 255")
    print(f"trained in {time.perf_counter() - begun:.0f} s")
    torch.manual_seed(seed + 1)  # the same held-out pairs however long it trained
    with torch.no_grad():
        held = held_out(visible)
        report(held, ways(network, matrices, held, visible), matrices)
        draw(out, held, network, matrices, visible)
    print(f"{time.perf_counter() - begun:.0f} s in all")


# --- the network and the solve ---------------------------------------------------------------------------------------


def weigher() -> torch.nn.Module:
    """Returns a network from a picture, what is not explained of it, and what is visible, to a logit per sample."""
    return torch.nn.Sequential(
        torch.nn.Conv2d(7, 24, 3, padding=1, padding_mode="replicate"),
        torch.nn.ReLU(),
        torch.nn.Conv2d(24, 24, 3, padding=1, padding_mode="replicate"),
        torch.nn.ReLU(),
        torch.nn.Conv2d(24, 1, 3, padding=1, padding_mode="replicate"),
    )


def weights(network: torch.nn.Module, matrix: Tensor, seen: Tensor, visible: Tensor) -> Tensor:
    """Returns how much each sample counts, in [0, 1]; 0 where it is not seen. A common factor says nothing."""
    with torch.no_grad():
        left = seen - tl.irradiance(matrix, light(matrix, seen, visible.expand(len(seen), -1)))
    mask = visible.expand(len(seen), 1, -1)
    features = torch.cat([seen * visible, 20 * left * visible, mask], dim=1).unflatten(-1, (SIDE, SIDE))
    return torch.sigmoid(network(features).flatten(start_dim=-2)[:, 0] + 2) * visible


def light(matrix: Tensor, seen: Tensor, weight: Tensor) -> Tensor:
    """Returns the light that explains samples of some weight."""
    return tl.solve(matrix, tl.Observation(seen, weight), SOLVER).coefficients


def relit(matrices: list[Tensor], seen: Tensor, weight: Tensor) -> Tensor:
    """Returns what the other block's plane shows under the light found: what the loss is about."""
    return tl.irradiance(matrices[1], light(matrices[0], seen, weight))


# --- pairs -----------------------------------------------------------------------------------------------------------


def random_lights(count: int) -> tl.EnvironmentMap:
    """Returns skies that differ: a gradient of one colour and up to four lamps of others, broad or small."""
    row, column = torch.meshgrid((torch.arange(16) + 0.5) / 16, (torch.arange(32) + 0.5) / 32, indexing="ij")
    theta, phi = torch.pi * row, torch.pi * (1 - 2 * column)
    directions = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], dim=-1)
    radiance = torch.rand(count, 3, 1, 1) * (0.2 + theta.cos().clamp(min=0))
    for _ in range(4):
        towards = torch.nn.functional.normalize(torch.randn(count, 3) + torch.tensor([0.0, 0.0, 1.0]), dim=-1)
        narrow = torch.exp(1.5 + 4 * torch.rand(count, 1, 1))
        lobe = torch.exp(narrow * (torch.einsum("hwd,nd->nhw", directions, towards) - 1))
        power = torch.rand(count, 3, 1, 1) * (torch.rand(count, 1, 1, 1) < 0.6) * narrow[:, None]
        radiance = radiance + power * lobe[:, None]
    return tl.EnvironmentMap(radiance)


def discs(count: int) -> Tensor:
    """Returns what round stains leave of the light, [pairs 3 points]: three of one colour each."""
    stains = torch.ones(count, 3, SIDE * SIDE)
    for _ in range(3):
        away = sample_centers(RECEIVER).float() - (4 * torch.rand(count, 1, 2) - 2)
        inside = away.norm(dim=-1) < 0.15 + 0.3 * torch.rand(count, 1)
        stains *= torch.where(inside[:, None], 0.4 + 0.5 * torch.rand(count, 3, 1), torch.ones(1))
    return stains


def stripes(count: int) -> Tensor:
    """Returns what two straight streaks leave of the light, [pairs 3 points]: no disc, and never trained on."""
    stains = torch.ones(count, 3, SIDE * SIDE)
    for _ in range(2):
        angle = torch.pi * torch.rand(count, 1)
        normal = torch.stack([angle.cos(), angle.sin()], dim=-1)
        away = (sample_centers(RECEIVER).float() * normal).sum(dim=-1) - (2.4 * torch.rand(count, 1) - 1.2)
        stains *= torch.where((away.abs() < 0.12)[:, None], 0.4 + 0.5 * torch.rand(count, 3, 1), torch.ones(1))
    return stains


def photographed(shown: Tensor, other: Tensor, stains: Tensor, visible: Tensor) -> Pairs:
    """Returns photographs of v = E / pi, as irradiance in units of their brightest sample."""
    unit = (shown * visible).amax(dim=(-2, -1), keepdim=True)
    seen = shown / unit * stains
    seen = eight_bit((seen + NOISE * torch.randn(seen.shape)).clamp(0, 1))
    return Pairs(seen, other / unit, (stains == 1).all(dim=1).float())


def held_out(visible: Tensor) -> Pairs:
    """Returns pairs cast by rays, under new lights and with stains of another shape."""
    lights = random_lights(HELD_OUT)
    shown, other = (tl.relight(scene, lights, RAYS) for scene in (SHOWN, OTHER))
    return photographed(shown, other, stripes(HELD_OUT), visible)


# --- what it brought -------------------------------------------------------------------------------------------------


def ways(network: torch.nn.Module, matrices: list[Tensor], held: Pairs, visible: Tensor) -> dict[str, Tensor]:
    """Returns the weights by several ways of weighing samples."""
    every = visible.expand(len(held.seen), -1)
    huber = tl.Observation(held.seen, every)
    for _ in range(ROUNDS):
        predicted = tl.irradiance(matrices[0], light(matrices[0], held.seen, huber.weights))
        huber = robust_weights(tl.Observation(held.seen, every), predicted, (SIDE, SIDE))
    return {
        "all samples alike": every,
        "Huber's weights, as --robust": huber.weights,
        "the network's weights": weights(network, matrices[0], held.seen, visible),
        "the stains known": every * held.clean,
    }


def errors(held: Pairs, matrices: list[Tensor], weight: Tensor) -> Tensor:
    """Returns the RMS of 255 of the other pose, per pair."""
    return rms_255(relit(matrices, held.seen, weight), held.other, visible_samples(OTHER).float().expand(HELD_OUT, -1))


def report(held: Pairs, weighed: dict[str, Tensor], matrices: list[Tensor]) -> None:
    """Prints how well each way predicts the other pose."""
    print("| held out: 12 lights, streaks | mean RMS of 255, other pose | worst |\n| --- | --- | --- |")
    for name, weight in weighed.items():
        found = errors(held, matrices, weight)
        print(f"| {name} | {found.mean():.2f} | {found.max():.2f} |")


def draw(out: Path, held: Pairs, network: torch.nn.Module, matrices: list[Tensor], visible: Tensor) -> None:
    """Draws a photograph, its weights, and the errors on the other pose without and with them."""
    weighed = ways(network, matrices, held, visible)
    plain, trained = weighed["all samples alike"], weighed["the network's weights"]
    gains = errors(held, matrices, plain) / errors(held, matrices, trained)
    item = int(gains.argsort()[HELD_OUT // 2])  # one that gained as much as half of them
    figure = Figure(figsize=(13, 3.6), dpi=100, layout="constrained")
    axes = figure.subplots(1, 4)
    photograph = torch.where(visible > 0, held.seen[item], torch.ones(3, 1) * 0.5)
    panel(axes[0], photograph.T.clamp(0, 1).pow(1 / 2.2), "a photograph, streaks on the plane")
    share = (trained[item] / trained[item][visible > 0].median()).clamp(min=1e-4).log10()
    share = torch.where(visible > 0, share, torch.nan)
    shown = panel(axes[1], share, "the network's weights", "cividis", (-2.0, 0.5))
    figure.colorbar(shown, ax=axes[1], shrink=0.8, label="log10 of the weight over the median")
    for axis, weight, name in ((axes[2], plain, "all samples alike"), (axes[3], trained, "weighed")):
        rms = errors(held, matrices, weight)[item]
        wrong = 255 * (relit(matrices, held.seen, weight) - held.other)[item].mean(dim=0) / held.other[item].max()
        wrong = torch.where(visible_samples(OTHER), wrong, torch.nan)
        shown = panel(axis, wrong, f"error on another pose, {name}:\nRMS {rms:.1f} of 255", "RdBu_r", (-12.0, 12.0))
    figure.colorbar(shown, ax=axes[3], shrink=0.8, label="of 255")
    FigureCanvasAgg(figure)
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "training.png")


def panel(axis: Axes, values: Tensor, title: str, colours: str | None = None, ends: tuple[float, float] = (0, 1)):
    """Draws one value, or colour, per sample of the plane, and returns what a colour bar wants."""
    axis.set_title(title, fontsize=10)
    axis.set(xlabel="x", ylabel="y")
    picture = values.unflatten(0, (SIDE, SIDE)).numpy()
    return axis.imshow(picture, origin="lower", extent=(-2, 2, -2, 2), cmap=colours, vmin=ends[0], vmax=ends[1])


if __name__ == "__main__":
    tyro.cli(main)
