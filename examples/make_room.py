"""Render the example picture: a furnished room through a fisheye lens that is known exactly.

Needs Blender as a module (`pip install -e '.[rooms]'`, Python 3.11); nothing is downloaded, every
surface is made of Blender's own procedural textures. Run:

    python examples/make_room.py --out examples/room.jpg [--samples 10] [--width 1280]

The lens is equisolid, r = 2 f sin(θ / 2), which Cycles renders exactly. Its camera is written
beside the picture as room.truth.json, so that the example also tells how far the estimate is off.
"""

from __future__ import annotations

import argparse
import json
import math
from itertools import pairwise
from pathlib import Path

import bpy
import numpy as np

HORIZONTAL_FOV = math.radians(138.0)
SENSOR_MM = 36.0
WALL_X, WALL_Y, HEIGHT = 6.4, 7.2, 2.9  # metres: x to the right, y into the room, z up
EYE, LOOK_AT = (1.75, 0.7, 1.5), (3.35, 5.2, 1.3)


def material(name: str, colour: tuple[float, float, float], roughness: float = 0.6):
    """A plain surface."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    return made


def tiles(name: str, colours, mortar, size: tuple[float, float], gap: float, roughness: float):
    """Bricks or planks on the x-y or x-z plane by Blender's brick texture, in metres."""
    made = material(name, colours[0], roughness)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    shader = nodes["Principled BSDF"]
    brick, place, noise = (
        nodes.new(kind)
        for kind in ("ShaderNodeTexBrick", "ShaderNodeTexCoord", "ShaderNodeTexNoise")
    )
    brick.inputs["Scale"].default_value = 1.0
    brick.inputs["Brick Width"].default_value, brick.inputs["Row Height"].default_value = size
    brick.inputs["Mortar Size"].default_value = gap
    brick.inputs["Mortar Smooth"].default_value = 0.1
    for socket, colour in zip(("Color1", "Color2", "Mortar"), (*colours, mortar), strict=True):
        brick.inputs[socket].default_value = (*colour, 1.0)
    turn = nodes.new("ShaderNodeMapping")
    links.new(place.outputs["Object"], turn.inputs["Vector"])
    links.new(turn.outputs["Vector"], brick.inputs["Vector"])
    noise.inputs["Scale"].default_value = 9.0
    noise.inputs["Detail"].default_value = 6.0
    mix = nodes.new("ShaderNodeMix")
    mix.data_type, mix.blend_type = "RGBA", "MULTIPLY"
    mix.inputs["Factor"].default_value = 0.35
    links.new(turn.outputs["Vector"], noise.inputs["Vector"])
    links.new(brick.outputs["Color"], mix.inputs["A"])
    links.new(noise.outputs["Color"], mix.inputs["B"])
    links.new(mix.outputs["Result"], shader.inputs["Base Color"])
    bump = nodes.new("ShaderNodeBump")
    bump.inputs["Strength"].default_value = 0.25
    bump.inputs["Distance"].default_value = 0.004
    bump.invert = True
    links.new(brick.outputs["Fac"], bump.inputs["Height"])
    links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return made, turn


def box(low, high, surface, bevel: float = 0.0):
    """An axis-parallel box between two corners, in metres."""
    low, high = np.minimum(low, high), np.maximum(low, high)
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=tuple((low + high) / 2))
    made = bpy.context.object
    made.scale = tuple(np.maximum(high - low, 1e-4))
    bpy.ops.object.transform_apply(location=True, scale=True)  # textures then run in metres
    made.data.materials.append(surface)
    if bevel:
        rounding = made.modifiers.new("bevel", "BEVEL")
        rounding.width, rounding.segments = bevel, 3
    return made


class Palette:
    """The surfaces of the room."""

    def __init__(self) -> None:
        self.white = material("white", (0.82, 0.80, 0.76), 0.7)
        self.trim = material("trim", (0.86, 0.85, 0.82), 0.4)
        self.oak = material("oak", (0.46, 0.26, 0.12), 0.45)
        self.dark = material("dark wood", (0.075, 0.042, 0.024), 0.45)
        self.black = material("black", (0.02, 0.02, 0.022), 0.35)
        self.teal = material("teal", (0.055, 0.27, 0.28), 0.85)
        self.mustard = material("mustard", (0.62, 0.33, 0.04), 0.9)
        self.brass = material("brass", (0.72, 0.45, 0.14), 0.25)
        self.brass.node_tree.nodes["Principled BSDF"].inputs["Metallic"].default_value = 1.0
        self.leaf = material("leaf", (0.05, 0.17, 0.04), 0.6)
        self.clay = material("clay", (0.48, 0.18, 0.09), 0.8)
        oak_tones = ((0.5, 0.29, 0.14), (0.34, 0.18, 0.085))
        self.floor, _ = tiles("floor", oak_tones, (0.06, 0.035, 0.018), (1.35, 0.16), 0.006, 0.38)
        reds = ((0.46, 0.17, 0.1), (0.33, 0.105, 0.065))
        self.brick, turn = tiles("brick", reds, (0.52, 0.48, 0.43), (0.23, 0.077), 0.009, 0.85)
        turn.inputs["Rotation"].default_value = (math.pi / 2, 0.0, 0.0)


def shell(use: Palette) -> None:
    """Floor, walls, ceiling with beams, skirting boards."""
    thick = 0.2
    box((0, 0, -thick), (WALL_X, WALL_Y, 0), use.floor)
    box((0, 0, HEIGHT), (WALL_X, WALL_Y, HEIGHT + thick), use.white)
    box((0, WALL_Y, 0), (WALL_X, WALL_Y + thick, HEIGHT), use.brick)  # far wall
    box((0, -thick, 0), (WALL_X, 0, HEIGHT), use.white)  # behind the camera
    box((-thick, 0, 0), (0, WALL_Y, HEIGHT), use.white)  # left
    for y in np.arange(0.75, WALL_Y, 1.15):
        box((0, y, HEIGHT - 0.2), (WALL_X, y + 0.14, HEIGHT), use.dark, 0.006)
    box((0, 0, 0), (0.018, WALL_Y, 0.11), use.trim)
    box((WALL_X - 0.018, 0, 0), (WALL_X, WALL_Y, 0.11), use.trim)
    box((0, WALL_Y - 0.018, 0), (WALL_X, WALL_Y, 0.11), use.trim)


def windows(use: Palette) -> None:
    """The right wall with three tall windows, their bars and sills."""
    sill, lintel, thick = 0.75, 2.45, 0.24
    edges = [0.0]
    for start in (0.9, 3.0, 5.1):
        edges += [start, start + 1.35]
    edges.append(WALL_Y)
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        box((WALL_X, start, 0), (WALL_X + thick, end, HEIGHT), use.white)
    for start, end in zip(edges[1:-1:2], edges[2:-1:2], strict=True):
        box((WALL_X, start, 0), (WALL_X + thick, end, sill), use.white)
        box((WALL_X, start, lintel), (WALL_X + thick, end, HEIGHT), use.white)
        box(
            (WALL_X - 0.09, start - 0.05, sill - 0.04), (WALL_X + thick, end + 0.05, sill), use.trim
        )
        bars(use, start, end, sill, lintel)


def bars(use: Palette, start: float, end: float, sill: float, lintel: float) -> None:
    """The frame of one window: two columns, three rows of panes."""
    near, far, half = WALL_X + 0.08, WALL_X + 0.13, 0.022
    for y in np.linspace(start, end, 3):
        wide = half * (1.5 if y in (start, end) else 1.0)
        box((near, y - wide, sill), (far, y + wide, lintel), use.black)
    for z in np.linspace(sill, lintel, 4):
        box((near, start, z - half), (far, end, z + half), use.black)


def shelf(use: Palette, rng: np.random.Generator) -> None:
    """A bookcase along the left wall, its books in many colours."""
    depth, low, high, top = 0.34, 2.3, 5.3, 2.3
    box((0, low, 0), (0.02, high, top), use.oak)
    for y in np.linspace(low, high, 5):
        box((0, y - 0.016, 0), (depth, y + 0.016, top), use.oak)
    levels = np.linspace(0.08, top, 7)
    for z in levels:
        box((0, low, z - 0.014), (depth - 0.004, high, z + 0.014), use.oak)
    paper = [
        material(f"book {i}", tuple(0.04 + 0.5 * rng.random(3) ** 1.6), 0.7) for i in range(18)
    ]
    columns = np.linspace(low, high, 5)
    for z in levels[:-1]:
        for left, right in pairwise(columns):
            y, stop = left + 0.02, right - 0.03 - 0.3 * rng.random()
            while y < stop:
                wide, tall = rng.uniform(0.018, 0.05), rng.uniform(0.2, 0.31)
                deep = depth - rng.uniform(0.03, 0.12)
                box((0.03, y, z + 0.017), (deep, y + wide, z + tall), paper[rng.integers(18)])
                y += wide + 0.002


def bench(use: Palette) -> None:
    """A sideboard with drawers in the near left corner, and a mirror over it."""
    y0, y1, deep, top = 0.55, 1.95, 0.42, 0.78
    box((0.0, y0, 0.1), (deep, y1, top), use.white, 0.004)
    box((0.0, y0 - 0.03, top), (deep + 0.03, y1 + 0.03, top + 0.035), use.oak, 0.004)
    for y in (y0 + 0.02, (y0 + y1) / 2 + 0.01):
        for z in (0.13, 0.35, 0.57):
            wide = (y1 - y0) / 2 - 0.03
            box((deep, y, z), (deep + 0.015, y + wide, z + 0.19), use.trim, 0.004)
            box(
                (deep + 0.015, y + wide / 2 - 0.07, z + 0.09),
                (deep + 0.04, y + wide / 2 + 0.07, z + 0.105),
                use.brass,
            )
    box((0.0, y0 + 0.1, 1.05), (0.03, y1 - 0.1, 2.15), use.oak, 0.004)
    glass = material("glass", (0.8, 0.82, 0.82), 0.03)
    glass.node_tree.nodes["Principled BSDF"].inputs["Metallic"].default_value = 1.0
    box((0.03, y0 + 0.16, 1.11), (0.034, y1 - 0.16, 2.09), glass)


def door(use: Palette) -> None:
    """A panelled door in the far wall."""
    left, wide, tall, y = 0.55, 0.95, 2.1, WALL_Y
    for x in (left - 0.09, left + wide):
        box((x, y - 0.035, 0), (x + 0.09, y, tall + 0.09), use.trim, 0.004)
    box((left - 0.09, y - 0.035, tall), (left + wide + 0.09, y, tall + 0.09), use.trim, 0.004)
    box((left, y - 0.02, 0), (left + wide, y, tall), use.teal)
    for x in (left + 0.12, left + 0.53):
        for low, high in ((0.2, 0.85), (1.0, 1.9)):
            box((x, y - 0.034, low), (x + 0.3, y, high), use.teal, 0.006)
    box((left + wide - 0.09, y - 0.08, 1.0), (left + wide - 0.06, y, 1.03), use.brass)
    box((left + wide - 0.19, y - 0.085, 1.0), (left + wide - 0.06, y - 0.065, 1.025), use.brass)


def paintings(use: Palette, rng: np.random.Generator) -> None:
    """Framed abstract pictures on the brick wall."""
    y = WALL_Y
    for left, low, wide, tall in (
        (2.1, 1.25, 0.8, 1.05),
        (3.1, 1.25, 1.3, 0.95),
        (4.6, 1.35, 0.6, 0.8),
    ):
        edge = 0.035
        box((left, y - 0.035, low), (left + wide, y, low + tall), use.black)
        box(
            (left + edge, y - 0.04, low + edge),
            (left + wide - edge, y, low + tall - edge),
            use.trim,
        )
        bottom, top = low + 0.1, low + tall - 0.1
        levels = np.sort(np.append(rng.uniform(bottom, top, 3), [bottom, top]))
        for number, (z0, z1) in enumerate(pairwise(levels)):
            tint = material(f"paint {left} {number}", tuple(0.05 + 0.6 * rng.random(3)), 0.8)
            box((left + 0.1, y - 0.044, z0), (left + wide - 0.1, y, z1), tint)


def table(use: Palette) -> None:
    """A dining table with four chairs, plates and a vase."""
    x0, x1, y0, y1, top = 3.3, 5.0, 2.75, 3.7, 0.75
    box((x0, y0, top - 0.04), (x1, y1, top), use.oak, 0.005)
    for x in (x0 + 0.05, x1 - 0.12):
        for y in (y0 + 0.05, y1 - 0.12):
            box((x, y, 0), (x + 0.07, y + 0.07, top - 0.04), use.dark)
    for x in (x0 + 0.25, x1 - 0.7):
        chair(use, x, y0 - 0.3, -1)
        chair(use, x, y1 - 0.12, 1)
    bpy.ops.mesh.primitive_cylinder_add(radius=0.07, depth=0.24, location=(4.2, 3.2, top + 0.12))
    bpy.context.object.data.materials.append(use.clay)
    rng = np.random.default_rng(5)
    for _ in range(34):
        at = np.array([4.2, 3.2, top + 0.42]) + rng.normal(0, (0.09, 0.09, 0.08))
        bpy.ops.mesh.primitive_uv_sphere_add(radius=rng.uniform(0.025, 0.05), location=tuple(at))
        bpy.context.object.data.materials.append(use.leaf if rng.random() < 0.7 else use.mustard)


def chair(use: Palette, x: float, y: float, side: int) -> None:
    """A chair of boxes, its back on the side away from the table."""
    wide, seat, back = 0.42, 0.46, 0.92
    rear = y if side < 0 else y + wide - 0.035
    box((x, y, seat - 0.035), (x + wide, y + wide, seat), use.mustard, 0.008)
    for dx in (0, wide - 0.035):
        for dy in (0, wide - 0.035):
            box((x + dx, y + dy, 0), (x + dx + 0.035, y + dy + 0.035, seat - 0.035), use.black)
        box((x + dx, rear, seat), (x + dx + 0.035, rear + 0.035, back), use.black)
    for z in (0.62, 0.74, 0.86):
        box((x, rear, z), (x + wide, rear + 0.03, z + 0.06), use.mustard, 0.004)


def sofa(use: Palette) -> None:
    """A sofa before the brick wall, a low table and a striped rug."""
    x0, x1, y = 2.2, 4.6, WALL_Y - 0.15
    box((x0, y - 0.9, 0.1), (x1, y, 0.42), use.teal, 0.03)
    box((x0, y - 0.22, 0.42), (x1, y, 0.86), use.teal, 0.05)
    for x in (x0 - 0.18, x1):
        box((x, y - 0.9, 0.1), (x + 0.18, y, 0.62), use.teal, 0.04)
    middle = (x0 + x1) / 2
    for left, right in ((x0, middle - 0.005), (middle + 0.005, x1)):
        box((left, y - 0.88, 0.42), (right, y - 0.2, 0.54), use.teal, 0.04)
    for left, tint in ((x0 + 0.12, use.mustard), (x1 - 0.55, use.clay)):
        box((left, y - 0.42, 0.56), (left + 0.43, y - 0.26, 0.94), tint, 0.06)
    box((2.75, 5.05, 0.33), (4.05, 5.6, 0.37), use.dark, 0.004)
    for x in (2.8, 3.95):
        for leg in (5.1, 5.5):
            box((x, leg, 0.0), (x + 0.05, leg + 0.05, 0.33), use.black)
    pale, deep = (
        material("rug pale", (0.62, 0.55, 0.44), 0.95),
        material("rug", (0.12, 0.2, 0.27), 0.95),
    )
    for number, x in enumerate(np.linspace(2.2, 4.6, 13)[:-1]):
        box((x, 4.4, 0), (x + 0.2, 6.2, 0.012), pale if number % 2 else deep)


def lamps(use: Palette) -> None:
    """Three pendant lamps over the table."""
    glow = bpy.data.materials.new("bulb")
    glow.use_nodes = True
    shader = glow.node_tree.nodes["Principled BSDF"]
    shader.inputs["Emission Color"].default_value = (1.0, 0.72, 0.42, 1.0)
    shader.inputs["Emission Strength"].default_value = 18.0
    for x in (3.6, 4.15, 4.7):
        box((x - 0.004, 3.216, 1.95), (x + 0.004, 3.224, HEIGHT), use.black)
        bpy.ops.mesh.primitive_cone_add(
            radius1=0.15, radius2=0.03, depth=0.2, location=(x, 3.22, 1.88), end_fill_type="NOTHING"
        )
        bpy.context.object.data.materials.append(use.brass)
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.04, location=(x, 3.22, 1.82))
        bpy.context.object.data.materials.append(glow)


def light(scene) -> None:
    """Sky and sun outside, and helpers at the windows that let the sampler find them."""
    world = bpy.data.worlds.new("sky")
    scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    sky = nodes.new("ShaderNodeTexSky")
    sky.sky_type = "NISHITA"
    sky.sun_elevation, sky.sun_rotation = math.radians(33), math.radians(112)
    sky.sun_intensity = 0.22
    links.new(sky.outputs["Color"], nodes["Background"].inputs["Color"])
    nodes["Background"].inputs["Strength"].default_value = 0.42
    for start in (0.9, 3.0, 5.1):
        bpy.ops.object.light_add(
            type="AREA",
            location=(WALL_X + 0.2, start + 0.675, 1.6),
            rotation=(0, math.pi / 2, 0),
        )
        portal = bpy.context.object.data
        portal.shape, portal.size, portal.size_y = "RECTANGLE", 1.7, 1.35
        portal.cycles.is_portal = True


def ground() -> None:
    """What is seen through the windows: a lawn and a row of plain houses."""
    lawn = material("lawn", (0.09, 0.16, 0.05), 1.0)
    box((WALL_X + 0.5, -60, -3.2), (WALL_X + 90, 70, -3.0), lawn)
    rng = np.random.default_rng(3)
    for y in np.arange(-30, 50, 9.0):
        wall = material(f"house {y}", tuple(0.3 + 0.35 * rng.random(3)), 0.9)
        box((WALL_X + 24, y, -3), (WALL_X + 32, y + 7.5, rng.uniform(1.5, 5.5)), wall)


def fisheye(scene) -> None:
    """The lens, the viewpoint."""
    data = bpy.data.cameras.new("fisheye")
    eye = bpy.data.objects.new("fisheye", data)
    scene.collection.objects.link(eye)
    scene.camera = eye
    eye.location = EYE
    forward = np.subtract(LOOK_AT, EYE)
    heading, pitch = (
        math.atan2(forward[0], forward[1]),
        math.atan2(forward[2], math.hypot(forward[0], forward[1])),
    )
    eye.rotation_euler = (math.pi / 2 + pitch, 0.0, -heading)
    data.type = "PANO"
    data.panorama_type = "FISHEYE_EQUISOLID"
    data.sensor_width = SENSOR_MM
    data.sensor_fit = "HORIZONTAL"
    data.fisheye_lens = focal_mm()
    data.fisheye_fov = 2 * math.pi
    data.clip_start = 0.01


def focal_mm() -> float:
    """Focal length that gives the field of view: r = 2 f sin(θ / 2)."""
    return SENSOR_MM / 2 / (2 * math.sin(HORIZONTAL_FOV / 4))


def truth(width: int, height: int) -> dict[str, object]:
    """The lens as a Kannala–Brandt camera: the series of 2 f sin(θ / 2), f in half widths."""
    focal = focal_mm() / (SENSOR_MM / 2)
    k = [2 * focal * (-1) ** i / math.factorial(2 * i + 1) / 2 ** (2 * i + 1) for i in range(5)]
    half = width / 2
    return {
        "format": "straightlens camera",
        "version": 1,
        "status": "ok",
        "reason": "the lens that the picture was rendered with",
        "model": "kannala-brandt",
        "k": k,
        "m_u": half,
        "m_v": half,
        "u0": (width - 1) / 2,
        "v0": (height - 1) / 2,
        "width": width,
        "height": height,
    }


def render(out: Path, width: int, height: int, samples: int) -> None:
    """Set up Cycles and write the picture."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = samples
    scene.cycles.use_adaptive_sampling = True
    scene.cycles.adaptive_threshold = 0.02
    scene.cycles.use_denoising = True
    scene.cycles.denoiser = "OPENIMAGEDENOISE"
    scene.cycles.max_bounces = 8
    scene.cycles.diffuse_bounces = 5
    scene.cycles.sample_clamp_indirect = 6.0
    scene.cycles.seed = 1
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"
    scene.view_settings.exposure = 1.55
    scene.render.image_settings.file_format = "JPEG"
    scene.render.image_settings.quality = 92
    scene.render.filepath = str(out.resolve())
    bpy.ops.render.render(write_still=True)


def main() -> None:
    """Build the room and render it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/room.jpg"))
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--samples", type=int, default=10)
    options = parser.parse_args()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    use, rng = Palette(), np.random.default_rng(7)
    shell(use)
    windows(use)
    bench(use)
    shelf(use, rng)
    door(use)
    paintings(use, rng)
    table(use)
    sofa(use)
    lamps(use)
    ground()
    light(bpy.context.scene)
    fisheye(bpy.context.scene)
    height = options.width * 3 // 4
    render(options.out, options.width, height, options.samples)
    lens = json.dumps(truth(options.width, height), indent=2) + "\n"
    options.out.with_suffix(".truth.json").write_text(lens, encoding="utf-8")


if __name__ == "__main__":
    main()
