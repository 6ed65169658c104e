"""Renders scenes with Blender as a module: one JSON job a line on stdin, one line a result.

Runs by its path in an interpreter that has `bpy` 4.5 and NumPy, and imports nothing of this
project: Blender wants an older NumPy than the rest, and a crash of it costs one job only.

    python worker.py < jobs

A job names the scene's arrays, the lens and the two pictures to write, or one panorama, or rays to
trace in the scene; see `render.py`.
"""

import json
import math
import sys
import tempfile
import traceback

import bpy  # type: ignore[import-not-found]
import mathutils  # type: ignore[import-not-found]
import mathutils.bvhtree  # type: ignore[import-not-found]
import numpy as np

sys.path.append(bpy.utils.resource_path("LOCAL") + "/python/lib/python3.11/site-packages")
from cycles import osl  # type: ignore[import-not-found]

RESULT = "@result "
LENS_SHADER = """
float image_radius(float t, float k1, float k2, float k3, float k4, float k5)
{
  float s = t * t;
  return t * (k1 + s * (k2 + s * (k3 + s * (k4 + s * k5))));
}

shader camera(float k1 = 1.0, float k2 = 0.0, float k3 = 0.0, float k4 = 0.0, float k5 = 0.0,
              float m_v = 1.0, float u0 = 0.0, float v0 = 0.0,
              float theta_max = 1.5, float circle = 1000.0, float half_height = 1.0,
              output point position = 0.0, output vector direction = 0.0,
              output color throughput = 1.0)
{
  point raster = camera_shader_raster_position();
  float across = 2.0 * raster.x - 1.0;
  float down = 1.0 - 2.0 * raster.y;
  float x = across - u0;
  float y = (down - v0) / m_v;
  float r = sqrt(x * x + y * y);
  if (r > circle || fabs(down) > half_height ||
      r > image_radius(theta_max, k1, k2, k3, k4, k5)) {
    throughput = color(0.0);
    return;
  }
  float low = 0.0;
  float high = theta_max;
  for (int i = 0; i < 40; i++) {
    float middle = 0.5 * (low + high);
    if (image_radius(middle, k1, k2, k3, k4, k5) < r) low = middle;
    else high = middle;
  }
  float theta = 0.5 * (low + high);
  float scale = r > 1e-7 ? sin(theta) / r : 0.0;
  direction = vector(x * scale, -y * scale, cos(theta));
}
"""
CORNERS = np.array([[(-1.0) ** ((i >> a) + 1) for a in range(3)] for i in range(8)])
# corners of each face, with (u, v) running as in learned.slf.boxes, and seen from without
FACES = (
    ((0, 4, 6, 2), (2, 1)),
    ((1, 5, 7, 3), (2, 1)),
    ((0, 1, 5, 4), (0, 2)),
    ((2, 3, 7, 6), (0, 2)),
    ((0, 1, 3, 2), (0, 1)),
    ((4, 5, 7, 6), (0, 1)),
)
SKIES = ("city", "forest", "sunrise", "sunset")
VIEWS = ("forest", "sunrise", "sunset")  # no houses: their lines would not be known
MIDDLE_GREY = 0.35  # linear; half of the picture may be brighter
FIRST_MODEL = 1_000_000  # surfaces below are materials of boxes
TREE = {}
PARAMETERS = ("k1", "k2", "k3", "k4", "k5", "m_v", "u0", "v0", "theta_max", "circle", "half_height")


def to_blender(points):
    """World axes x right, y down, z forward to Blender's x right, y forward, z up."""
    points = np.asarray(points, float)
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def clear():
    """Remove everything of the last job."""
    for group in ("objects", "meshes", "materials", "lights", "images", "cameras", "texts"):
        for item in list(getattr(bpy.data, group)):
            getattr(bpy.data, group).remove(item, do_unlink=True)


def box_corners(boxes):
    """Corners of all boxes in their own axes and in Blender's, (n, 8, 3) each."""
    centre, half, yaw = (np.array(boxes[n], float) for n in ("centre", "half", "yaw"))
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    local = CORNERS[None] * half[:, None]
    turned = np.stack(
        [
            c * local[..., 0] + s * local[..., 2],
            local[..., 1],
            -s * local[..., 0] + c * local[..., 2],
        ],
        axis=-1,
    )
    return local, to_blender(turned + centre[:, None])


def build_mesh(boxes, materials, face_material):
    """One mesh of all boxes; texture coordinates in metres from each face's corner."""
    local, corners = box_corners(boxes)
    half, vertices = np.array(boxes["half"], float), corners.reshape(-1, 3)
    polygons, uv, index = [], [], []
    for i in range(len(local)):
        for f, (corners, (a, b)) in enumerate(FACES):
            if face_material[i][f] < 0:
                continue
            polygons.append([8 * i + j for j in corners])
            uv += [(local[i, j, a] + half[i, a], local[i, j, b] + half[i, b]) for j in corners]
            index.append(face_material[i][f])
    mesh = bpy.data.meshes.new("scene")
    mesh.from_pydata(vertices.tolist(), [], polygons)
    layer = mesh.uv_layers.new(name="metres")
    layer.data.foreach_set("uv", np.array(uv, np.float32).ravel())
    for material in materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", np.array(index, np.int32))
    mesh.update()
    bpy.context.collection.objects.link(bpy.data.objects.new("scene", mesh))


def to_blender_pose(pose):
    """An affine map into the world's axes as one into Blender's."""
    pose = np.asarray(pose, float)
    out = np.eye(4)
    out[:3] = to_blender(pose[:3].T).T
    return out


def import_models(job):
    """Models with their own materials, in place."""
    for model in job["models"]:
        bpy.ops.wm.obj_import(filepath=model["obj"], forward_axis="Y", up_axis="Z")
        for item in bpy.context.selected_objects:
            item.matrix_world = mathutils.Matrix(to_blender_pose(model["pose"]).tolist())


def scene_tree(job):
    """A tree for tracing rays, and the surface of each of its polygons."""
    scene = job["scene"]
    _, corners = box_corners(scene)
    vertices, polygons, surface = [corners.reshape(-1, 3)], [], []
    for i, materials in enumerate(scene["face_material"]):
        for (face, _), material in zip(FACES, materials, strict=True):
            if material >= 0:
                polygons.append([8 * i + j for j in face])
                surface.append(material)
    count = len(vertices[0])
    for number, model in enumerate(job["models"]):
        mesh = np.load(model["mesh"])
        pose = to_blender_pose(model["pose"])
        vertices.append(mesh["vertices"] @ pose[:3, :3].T + pose[:3, 3])
        polygons += (mesh["triangles"] + count).tolist()
        surface += [FIRST_MODEL + number] * len(mesh["triangles"])
        count += len(mesh["vertices"])
    points = np.concatenate(vertices).tolist()
    return mathutils.bvhtree.BVHTree.FromPolygons(points, polygons), np.array(surface)


def trace(job):
    """Distance, normal and surface that rays from the camera meet first, written as one array."""
    if TREE.get("key") != job["key"]:
        TREE["key"], TREE["tree"] = job["key"], scene_tree(job)
    tree, surface = TREE["tree"]
    rays = np.load(job["rays"])
    eye = mathutils.Vector(to_blender(job["scene"]["position"]).tolist())
    hits = np.zeros((len(rays), 5))
    for i, direction in enumerate(to_blender(rays).tolist()):
        _, normal, polygon, distance = tree.ray_cast(eye, direction)
        if polygon is None:
            hits[i] = math.inf, 0.0, 0.0, 0.0, -1.0
        else:
            x, y, z = normal
            hits[i] = distance, x, -z, y, surface[polygon]
    np.save(job["hits"], hits)


def build_material(number, job):
    """Principled shader of one material, with its drawn texture mirrored and repeated."""
    scene = job["scene"]
    material = bpy.data.materials.new(f"m{number}")
    material.use_nodes = True
    tree = material.node_tree
    shader = tree.nodes["Principled BSDF"]
    colour = (*scene["colour"][number], 1.0)
    shader.inputs["Base Color"].default_value = colour
    shader.inputs["Roughness"].default_value = scene["roughness"][number]
    if scene["emission"][number] > 0:
        shader.inputs["Emission Color"].default_value = (1.0, 0.97, 0.92, 1.0)
        shader.inputs["Emission Strength"].default_value = scene["emission"][number]
        if scene["is_pane"][number]:
            add_view(tree, shader, scene)
    if scene["pattern"][number] >= 0:
        add_pattern(
            tree, shader, job["patterns"][str(scene["pattern"][number])], scene["tile"][number]
        )
    return material


def add_pattern(tree, shader, path, tile):
    """Texture from a file: u grows to the right and v downwards, mirrored at every repeat."""
    image = tree.nodes.new("ShaderNodeTexImage")
    image.image = bpy.data.images.load(path, check_existing=True)
    image.extension = "MIRROR"
    image.interpolation = "Linear"
    place = tree.nodes.new("ShaderNodeMapping")
    place.inputs["Scale"].default_value = (1.0 / tile[0], -1.0 / tile[1], 1.0)
    # v grows upwards in Blender: the first repeat hangs from 1 down to 0
    place.inputs["Location"].default_value = (0.0, 1.0, 0.0)
    uv = tree.nodes.new("ShaderNodeUVMap")
    uv.uv_map = "metres"
    tree.links.new(uv.outputs["UV"], place.inputs["Vector"])
    tree.links.new(place.outputs["Vector"], image.inputs["Vector"])
    tree.links.new(image.outputs["Color"], shader.inputs["Base Color"])


def build_lights(scene):
    """Ceiling lamps as areas, and the sky."""
    for x, y, z, wide, deep, power in scene["lights"]:
        light = bpy.data.lights.new("lamp", "AREA")
        light.shape, light.size, light.size_y, light.energy = "RECTANGLE", wide, deep, power
        item = bpy.data.objects.new("lamp", light)
        item.location = to_blender([x, y + 0.02, z])
        bpy.context.collection.objects.link(item)
    world = bpy.data.worlds.new("world")
    bpy.context.scene.world = world
    world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Strength"].default_value = max(scene["sky"], 0.25)
    if scene["sky"] > 0:
        add_sky(world.node_tree, background, scene)


def add_sky(tree, background, scene):
    """One of Blender's own panoramas, turned."""
    place = tree.nodes.new("ShaderNodeTexCoord")
    sky = panorama(tree, place.outputs["Generated"], SKIES, scene)
    tree.links.new(sky, background.inputs["Color"])


def add_view(tree, shader, scene):
    """What the camera sees through a pane; the pane lights the room evenly, which is less noisy."""
    geometry, path, mix, outwards = (
        tree.nodes.new(f"ShaderNode{kind}")
        for kind in ("NewGeometry", "LightPath", "MixRGB", "VectorMath")
    )
    outwards.operation = "SCALE"
    outwards.inputs["Scale"].default_value = -1.0
    tree.links.new(geometry.outputs["Incoming"], outwards.inputs[0])
    view = panorama(tree, outwards.outputs[0], VIEWS, scene)
    mix.inputs["Color1"].default_value = shader.inputs["Emission Color"].default_value
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs["Fac"])
    tree.links.new(view, mix.inputs["Color2"])
    tree.links.new(mix.outputs["Color"], shader.inputs["Emission Color"])


def panorama(tree, direction, names, scene):
    """Colours of one of Blender's own panoramas in a direction, turned."""
    folder = bpy.utils.resource_path("LOCAL") + "/datafiles/studiolights/world"
    sky = tree.nodes.new("ShaderNodeTexEnvironment")
    name = names[int(scene["sky_turn"] * 1e3) % len(names)]
    sky.image = bpy.data.images.load(f"{folder}/{name}.exr", check_existing=True)
    turn = tree.nodes.new("ShaderNodeMapping")
    turn.inputs["Rotation"].default_value[2] = scene["sky_turn"]
    tree.links.new(direction, turn.inputs["Vector"])
    tree.links.new(turn.outputs["Vector"], sky.inputs["Vector"])
    return sky.outputs["Color"]


def set_camera(job, kind):
    """The polynomial lens as a shader, the protocol's pinhole of the same pose, or all around."""
    data = bpy.data.cameras.new("camera")
    data.clip_start, data.clip_end = 0.01, 1000.0
    item = bpy.data.objects.new("camera", data)
    bpy.context.collection.objects.link(item)
    rotation = np.array(job["scene"]["rotation"], float)
    axes = to_blender(rotation.T).T * [1.0, -1.0, -1.0]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes, to_blender(job["scene"]["position"])
    item.matrix_world = mathutils.Matrix(pose.tolist())
    bpy.context.scene.camera = item
    if kind == "straight":
        data.sensor_width, data.lens = 2.0, 1.0
        return
    if kind == "panorama":
        data.type, data.panorama_type = "PANO", "EQUIRECTANGULAR"
        return
    data.type, data.custom_mode = "CUSTOM", "INTERNAL"
    text = bpy.data.texts.new("lens.osl")
    text.write(LENS_SHADER)
    data.custom_shader = text
    problems = []
    osl.update_custom_camera_shader(data, lambda kind, what: problems.append((kind, what)))
    if any("ERROR" in kind for kind, _ in problems):
        raise RuntimeError(f"lens shader: {problems}")
    for name in PARAMETERS:
        data.cycles_custom[name] = float(job["lens"][name])
    data.update_tag()


def set_renderer(job):
    """Few samples and the denoiser; the same seed gives the same picture."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.seed = "CPU", job["samples"], job["seed"]
    cycles.use_denoising, cycles.denoiser = job["denoise"], "OPENIMAGEDENOISE"
    cycles.use_adaptive_sampling = False
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 5, 4, 2
    cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 1.2
    cycles.caustics_reflective = cycles.caustics_refractive = False
    render = scene.render
    render.resolution_y = job["size"]
    render.resolution_x = (2 if "panorama" in job else 1) * job["size"]
    render.resolution_percentage = 100
    render.use_persistent_data = True
    render.threads_mode, render.threads = "FIXED", job["threads"]
    render.dither_intensity = 0.0
    render.use_stamp = False
    scene.view_settings.view_transform = "Standard"


def save(path, file_format, depth):
    """Write the last render; only a PNG is seen through the exposure."""
    settings = bpy.context.scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = file_format, "RGB", depth
    bpy.data.images["Render Result"].save_render(path)


def metered():
    """Stops that darken the last render until half of what it shows is no brighter than grey."""
    with tempfile.TemporaryDirectory(prefix="metered-") as folder:
        path = f"{folder}/linear.exr"
        save(path, "OPEN_EXR", "32")
        image = bpy.data.images.load(path)
        pixels = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
    light = pixels.reshape(-1, 4)[:, :3] @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    middle = float(np.median(light[light > 0])) if (light > 0).any() else 0.0
    return min(0.0, math.log2(MIDDLE_GREY / max(middle, 1e-6)))


def run(job):
    """Render the pictures of a job; the first one sets the exposure."""
    clear()
    scene = job["scene"]
    materials = [build_material(i, job) for i in range(len(scene["colour"]))]
    build_mesh(scene, materials, scene["face_material"])
    import_models(job)
    build_lights(scene)
    set_renderer(job)
    view = bpy.context.scene.view_settings
    kinds = ("panorama",) if "panorama" in job else ("fisheye", "straight")
    for kind in kinds:
        set_camera(job, kind)
        bpy.ops.render.render()
        if kind == kinds[0]:
            view.exposure = scene["exposure"] + metered()
        save(job[kind], "PNG", "8")


def main():
    """Read jobs until stdin ends."""
    for line in sys.stdin:
        job = json.loads(line)
        try:
            trace(job) if "rays" in job else run(job)
            result = {"index": job["index"], "error": None}
        except Exception:
            result = {"index": job["index"], "error": traceback.format_exc()}
        sys.stdout.write(RESULT + json.dumps(result) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    if not math.isclose(bpy.app.version[0] + bpy.app.version[1] / 10, 4.5):
        sys.stderr.write(f"expected Blender 4.5, got {bpy.app.version_string}\n")
        sys.exit(2)
    main()
