"""Scenes of the drivers with finite strain, small and of few load steps, for restarts and numbers of ranks."""

from argparse import Namespace
from dataclasses import replace

from drivers._common import make_mesh
from drivers.cases import clip, large_sliding, large_strain, seal, spring, turning
from meshes import clip as clip_mesh
from meshes import hemisphere_on_cube, ironing_slab, round_bar, thick_cylinder
from meshes import seal as seal_mesh

COUNT = 4


def ready(scene, probes=(), count=COUNT):
    """With checkpoints, and a tolerance that leaves no digit open."""
    scene = replace(scene, petsc={**(scene.petsc or {}), "snes_rtol": "1e-12"})
    scene.steps.count = count
    scene.output.fields, scene.output.checkpoint, scene.output.probes = False, True, list(probes)
    return scene


def ring(folder):
    path = make_mesh(thick_cylinder, folder / "ring.msh", 2, (2, 12), inner=0.7, outer=1.0)
    return ready(large_sliding.ring_scene(path, 0.5, 0.1, COUNT))


def ironing(folder, **said):
    path = make_mesh(ironing_slab, folder / "ironing.msh", 2)
    scene = ready(large_sliding.ironing_scene(path, 0.5, 0.2, 2, 2))
    for key, value in said.items():
        setattr(scene.contacts[0], key, value)
    return scene


def upsetting(folder):
    path = make_mesh(round_bar, folder / "billet.msh", (4, 6), radius=10.0, length=30.0, waist=1.0)
    return ready(large_sliding.upsetting_scene(path, 0.1, COUNT), ["neck"])


def necking(folder):
    path = make_mesh(round_bar, folder / "bar.msh", (3, 8))
    return ready(large_strain.necking_scene(path, 0.6, COUNT), ["neck"], 8)


def turned(folder):
    path = make_mesh(hemisphere_on_cube, folder / "hemisphere.msh", 2, inner=turning.INNER)
    return ready(turning.hemisphere_scene(path, 2, 2, 0.3, 20.0))


def squeezed(folder):
    path = make_mesh(seal_mesh, folder / "seal.msh", (1, 10))
    return ready(seal.scene(path, 0.49, 0.3, depth=0.15))


def clipped(folder):
    path = make_mesh(clip_mesh, folder / "clip.msh", 2, 0.3, 2, "quadrilateral")
    scene = ready(clip.scene(path, 2, 0.2, order=2, strain="finite"), count=8)
    scene.steps.end = 0.2
    return scene


def wound(folder):
    args = Namespace(
        coils=2.5, radius=3.0, top=None, wire=1.0, pitch=1.4, h=0.5, along=2.0, order=1, friction=0.2, yield_stress=0.0,
        hardening=0.0, travel=1.0, steps=COUNT,
    )  # fmt: skip
    path = spring.mesh(folder / "spring.msh", args)
    return ready(spring.scene(path, args, 0.5 * spring.closing_travel(args), strain="finite"), ["end_top"])


SCENES = {
    "driver, ring": ring,
    "driver, ironing": ironing,
    "driver, ironing, theta -1": lambda folder: ironing(folder, theta=-1.0),
    "driver, ironing, closest point": lambda folder: ironing(folder, search="closest_point"),
    "driver, upsetting": upsetting,
    "driver, necking": necking,
    "driver, turning": turned,
    "driver, seal": squeezed,
    "driver, clip": clipped,
    "driver, spring": wound,
}
