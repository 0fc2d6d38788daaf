"""Meshes of the cases with known answers: each generator writes a binary gmsh file with named groups.

`GENERATORS` lists them by name; `python -m meshes NAME -o FILE.msh` runs one from a shell.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec

if sys.argv[0] == "-m" and find_spec("gmsh") is None:
    sys.exit("python -m meshes: found no Python package gmsh; remedy: pip install gmsh")

from .bars import round_bar
from .beam import beam
from .blocks import one_block, overclosed_cubes, two_blocks
from .clip import CLIP, ClipShape, clip
from .cook import cook
from .disk_on_block import disk_on_block
from .dome import dome_on_block
from .flange import flange
from .heap import heap
from .hertz import ball_on_block, cylinder_on_block, cylinders, two_balls
from .indent import indent
from .ironing import ironing, ironing_slab
from .layer import layer_on_base
from .parts import crowned_roller, disc_in_press, lug_on_pin
from .pin import pin
from .punch import cube_on_block, punch, rounded_punch
from .rings import rings
from .seal import seal
from .shells import shells, tubes
from .spheres import balls, sphere_stack
from .spring import c_strip, spring
from .thick_cylinder import cylinder_strip, thick_cylinder
from .turning import disk, hemisphere_on_cube, pad_on_ring

GENERATORS = {
    function.__name__: function
    for function in (
        one_block,
        two_blocks,
        overclosed_cubes,
        beam,
        rings,
        disk_on_block,
        flange,
        dome_on_block,
        cylinders,
        cylinder_on_block,
        two_balls,
        ball_on_block,
        ironing,
        ironing_slab,
        cook,
        round_bar,
        thick_cylinder,
        cylinder_strip,
        indent,
        clip,
        spring,
        c_strip,
        balls,
        sphere_stack,
        heap,
        layer_on_base,
        pin,
        lug_on_pin,
        disc_in_press,
        crowned_roller,
        punch,
        cube_on_block,
        rounded_punch,
        shells,
        tubes,
        hemisphere_on_cube,
        pad_on_ring,
        disk,
        seal,
    )
}

__all__ = ["CLIP", "GENERATORS", "ClipShape", *GENERATORS]
