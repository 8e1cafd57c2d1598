"""Maps over the hull: layout of the tiles, what the rays find, colours."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from geometry.boxes import LEAF, build_boxes
from geometry.shading import shading_normals
from geometry.tile_layout import TileLayout, least_texels
from geometry.topology import build_edges, face_normals, vertex_normals
from schemas.errors import CancelledError
from tests.meshes import bumpy_sphere, cube, eyes, joined, normalised, shared, sphere, torus
from worker.bake import Surface, bake_maps, hull_normals
from worker.hull import build_hull
from worker.kernels import bake_boxes, bake_color, bake_tiles


def quiet(_):
    pass


def convex_hull(points, grow=1.0):
    """A convex hull as a stand-in for a progressive one: (positions f4, faces i4, normals f4)."""
    hull = trimesh.convex.convex_hull(np.asarray(points, np.float64) * grow)
    positions, faces = hull.vertices.astype(np.float32), hull.faces.astype(np.int32)
    return positions, faces, hull_normals(positions, faces)


def bake(hull, mesh, appearance=None, texels=256, normals=None):
    positions, faces = mesh
    normals = vertex_normals(positions, faces) if normals is None else normals
    return bake_maps(*hull, positions, faces, normals, appearance, texels, quiet)


def test_creases_of_the_original_stay_sharp_in_the_map():
    positions, faces, _ = normalised(cube(4))
    shading = shading_normals(positions, faces)
    hull = convex_hull(positions, 1.1)
    maps = bake_maps(*hull, positions, faces, shading.normals, None, 256, quiet, corner_normals=shading.corner_normals)
    face = np.repeat(np.arange(len(hull[1])), 50)
    found = decoded(maps, face, weights_inside(len(face)))
    across = face_normals(hull[0], hull[1])[face]
    flat = np.einsum("ni,ni->n", found, across) > np.cos(np.radians(1.0))
    assert flat.mean() > 0.95  # the rest lies where the rays of one side of the hull meet another side of the cube


def weights_inside(count, seed=0):
    return np.random.default_rng(seed).dirichlet((1.0, 1.0, 1.0), count)


def weights_on_border(count, seed=0):
    rng = np.random.default_rng(seed)
    w = np.zeros((count, 3))
    side, t = rng.integers(0, 3, count), rng.uniform(0, 1, count)
    w[np.arange(count), side], w[np.arange(count), (side + 1) % 3] = t, 1 - t
    w[:3] = np.eye(3)
    return w


def footprint(uv, width, height):
    """Bilinear lookup at uv (n, 2): rows (n, 4), columns (n, 4), weights (n, 4)."""
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - i, y - j
    rows, columns = np.stack([j, j, j + 1, j + 1], 1), np.stack([i, i + 1, i, i + 1], 1)
    return rows, columns, np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], 1)


def lookup(image, tile_uv, face, weights):
    uv = np.einsum("nk,nki->ni", weights, tile_uv[face].astype(np.float64))
    rows, columns, w = footprint(uv, image.shape[1], image.shape[0])
    return np.einsum("nk,nkc->nc", w, image[rows, columns].astype(np.float64))


def decoded(maps, face, weights):
    n = lookup(maps.normal, maps.tile_uv, face, weights) / 127.5 - 1.0
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def on_hull(hull, face, weights):
    return np.einsum("nk,nki->ni", weights, hull[0][hull[1][face]].astype(np.float64))


def degrees_between(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ni,ni->n", a, b)))


# ---- tiles


@settings(deadline=None, max_examples=40)
@given(faces=st.integers(4, 3000), texels=st.integers(64, 512), seed=st.integers(0, 99))
def test_bilinear_lookup_in_a_tile_reads_only_its_own_texels(faces, texels, seed):
    assume(texels >= least_texels(faces))
    layout = TileLayout.fitting(faces, texels)
    turns = np.random.default_rng(seed).integers(0, 3, faces).astype(np.int32)
    tile_uv, owners = layout.tile_uv(turns), layout.owners()
    rng = np.random.default_rng(seed)
    face = np.concatenate([[0, faces - 1], rng.integers(0, faces, 60)])
    weights = np.concatenate([weights_on_border(40, seed), weights_inside(22, seed)])
    # a rasteriser interpolates in float32, a sampler rounds to 1/256 of a texel
    uv = np.einsum("nk,nki->ni", weights.astype(np.float32), tile_uv[face]).astype(np.float64)
    size = np.array([layout.width, layout.height])
    for rounded in (uv, np.rint(uv * size * 256) / 256 / size):
        rows, columns, w = footprint(rounded, layout.width, layout.height)
        assert np.all((owners[rows, columns] == face[:, None]) | (w <= 1e-12))


@settings(deadline=None, max_examples=40)
@given(faces=st.integers(4, 20_000), texels=st.integers(64, 1024))
def test_tiles_do_not_overlap_and_fill_the_map(faces, texels):
    assume(texels >= least_texels(faces))
    layout = TileLayout.fitting(faces, texels)
    assert max(layout.width, layout.height) <= texels
    own = (layout.side + 1) * (layout.side + 2) // 2 + layout.side
    assert np.count_nonzero(layout.owners() >= 0) == faces * own


@pytest.mark.parametrize("faces", [4, 5, 999, 1000])
def test_layout_is_known_from_its_texture_coordinates(faces):
    layout = TileLayout.fitting(faces, 300)
    turns = (np.arange(faces) % 3).astype(np.int32)
    assert TileLayout.of(layout.tile_uv(turns), layout.width, layout.height) == layout


@pytest.mark.parametrize("faces", [4, 1000, 6424, 100_000])
def test_a_hull_of_too_many_faces_gets_the_smallest_maps_that_hold_it(faces):
    least = least_texels(faces)
    assert TileLayout.fitting(faces, least).side >= 1
    cramped = TileLayout.fitting(faces, 4)
    assert cramped == TileLayout.fitting(faces, least)
    assert max(cramped.width, cramped.height) <= least <= 800
    assert ((least - 1) // 4) * ((least - 1) // 3) < (faces + 1) // 2


def test_the_right_angle_stands_opposite_the_longest_side():
    positions, faces, _ = normalised(bumpy_sphere(1))
    hull = (positions, faces, hull_normals(positions, faces))
    uv = bake(hull, (positions, faces)).tile_uv.astype(np.float64)
    p = positions[faces].astype(np.float64)
    opposite = np.linalg.norm(p[:, [1, 2, 0]] - p[:, [2, 0, 1]], axis=2)
    opposite_uv = np.linalg.norm(uv[:, [1, 2, 0]] - uv[:, [2, 0, 1]], axis=2)
    assert np.array_equal(np.argmax(opposite, axis=1), np.argmax(opposite_uv, axis=1))


# ---- normals


@pytest.fixture(scope="module")
def ball():
    """A fine sphere, and a coarse hull around it."""
    positions, faces, _ = normalised(sphere(5))
    return (positions, faces), convex_hull(sphere(2)[0], 1.06)


def test_normals_of_a_sphere_are_the_analytic_ones(ball):
    mesh, hull = ball
    maps = bake(hull, mesh, texels=512)
    face = np.random.default_rng(1).integers(0, len(hull[1]), 4000)
    weights = weights_inside(4000)
    expected = on_hull(hull, face, weights)
    assert maps.missed == 0
    assert degrees_between(decoded(maps, face, weights), expected).max() < 2.0


def test_a_flipped_normal_is_noticed(ball):
    mesh, hull = ball
    face, weights = np.arange(len(hull[1])), np.full((len(hull[1]), 3), 1 / 3)
    across = face_normals(hull[0], hull[1])
    outward = decoded(bake(hull, mesh), face, weights)
    assert np.all(np.einsum("ni,ni->n", outward, across) > 0.9)
    flipped = decoded(bake(hull, mesh, normals=-vertex_normals(*mesh)), face, weights)
    assert np.all(np.einsum("ni,ni->n", flipped, across) < -0.9)


def test_rays_go_inwards_and_meet_the_near_side():
    mesh = normalised(bumpy_sphere(4))[:2]
    hull = convex_hull(mesh[0], 1.001)
    layout = TileLayout.fitting(len(hull[1]), 256)
    across = face_normals(hull[0], hull[1])
    turns = np.zeros(layout.faces, np.int32)
    _, directions = bake_tiles.tile_rays(*hull, across, turns, layout.side, 0, layout.faces)
    owner = np.repeat(np.arange(layout.faces), bake_tiles.texels_per_tile(layout.side))
    assert np.einsum("ni,ni->n", directions, across[owner]).max() <= -bake_tiles.LEAST_FACING + 1e-9


def test_faces_that_share_an_edge_agree_along_it():
    mesh = normalised(bumpy_sphere(4))[:2]
    hull = convex_hull(mesh[0], 1.01)
    maps = bake(hull, mesh, texels=512)
    table = build_edges(hull[1])
    t = np.random.default_rng(3).uniform(0, 1, len(table.faces))
    seen = []
    for side in range(2):
        face = table.faces[:, side]
        weights = np.where(hull[1][face] == table.vertices[:, :1], 1 - t[:, None], 0.0)
        weights += np.where(hull[1][face] == table.vertices[:, 1:], t[:, None], 0.0)
        seen.append(lookup(maps.normal, maps.tile_uv, face, weights))
    # one unit is the rounding of the map; the inset moves the sample by 1/64 texel
    difference = np.abs(seen[0] - seen[1]).max(axis=1)
    assert np.percentile(difference, 95) < 2.0
    assert difference.max() < 8.0


def test_points_of_the_original_on_the_hull_are_found():
    positions, faces, _ = normalised(cube(6))
    hull = convex_hull(positions)
    maps = bake(hull, (positions, faces))
    flat = bake(hull, (positions, faces), normals=np.zeros_like(positions))  # without vertex normals: those of the faces
    face, weights = np.arange(len(hull[1])), np.full((len(hull[1]), 3), 1 / 3)
    assert maps.missed == 0
    assert degrees_between(decoded(flat, face, weights), face_normals(hull[0], hull[1])).max() < 0.5


def test_inner_sides_are_passed():
    inner, outer = sphere(4, 1.0), sphere(4, 1.02)
    positions, faces, _ = normalised(joined(inner, (outer[0], outer[1][:, ::-1])))
    hull = convex_hull(positions, 1.05)
    normals = vertex_normals(positions, faces)
    maps = bake(hull, (positions, faces), normals=normals)
    face, weights = np.arange(len(hull[1])), np.full((len(hull[1]), 3), 1 / 3)
    assert maps.missed == 0
    assert np.all(np.einsum("ni,ni->n", decoded(maps, face, weights), face_normals(hull[0], hull[1])) > 0.9)


def test_a_hollow_original_shows_its_outer_skin():
    outer, inner = sphere(4, 1.0), sphere(4, 0.9)
    mesh = normalised(joined(outer, (inner[0], inner[1][:, ::-1])))[:2]
    hull = convex_hull(mesh[0], 1.05)
    face, weights = np.arange(len(hull[1])), np.full((len(hull[1]), 3), 1 / 3)
    maps = bake(hull, mesh)
    assert maps.missed == 0
    assert np.all(np.einsum("ni,ni->n", decoded(maps, face, weights), face_normals(hull[0], hull[1])) > 0.9)


def test_rays_through_a_hole_are_misses_and_take_the_closest_point():
    mesh = normalised(torus(96, 48))[:2]
    hull = convex_hull(mesh[0], 1.0001)
    maps = bake(hull, mesh)
    assert 0 < maps.missed < maps.texel_count // 2
    # above the middle of the hole the ray runs through it; nothing there may be missing or zero
    n = maps.normal.astype(float) / 127.5 - 1.0
    length = np.linalg.norm(n, axis=2)[TileLayout.of(maps.tile_uv, *maps.normal.shape[1::-1]).owners() >= 0]
    assert np.percentile(length, 1) > 0.95


def test_an_original_off_to_one_side_is_all_closest_points():
    positions = (np.float32(0.02) * normalised(sphere(3))[0]) + np.float32([0.9, 0, 0])
    faces = sphere(3)[1]
    hull = convex_hull(np.concatenate([sphere(1)[0] * 1.2, positions]))
    maps = bake(hull, (positions, faces), texels=128)
    assert maps.missed > 0.9 * maps.texel_count
    face, weights = np.arange(len(hull[1])), np.full((len(hull[1]), 3), 1 / 3)
    towards = on_hull(hull, face, weights) - [0.9, 0, 0]
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    assert np.median(degrees_between(decoded(maps, face, weights), towards)) < 6.0


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000), spread=st.sampled_from([1e-6, 1e-3, 1.0]), needles=st.booleans())
def test_closest_points_are_those_of_brute_force(seed, spread, needles):
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(60, 3)).astype(np.float32)
    if needles:
        positions[:, 1:] *= np.float32(1e-4)
    faces = rng.integers(0, 60, (37, 3)).astype(np.int32)
    points = positions[rng.integers(0, 60, 30)] + spread * rng.normal(size=(30, 3))
    face, weights, distance2 = bake_boxes.closest_points(positions, faces, *build_boxes(positions, faces), points)
    brute = np.array([min(bake_boxes.closest_on_triangle(*positions[f], *p)[0] for f in faces) for p in points])
    assert np.allclose(distance2, brute, rtol=1e-9, atol=1e-15)
    reached = np.einsum("nk,nki->ni", weights, positions[faces[face]].astype(np.float64))
    assert np.allclose(np.linalg.norm(reached - points, axis=1), np.sqrt(distance2), atol=1e-12)
    dense = np.einsum("wk,fki->wfi", rng.dirichlet((0.5, 0.5, 0.5), 200), positions[faces].astype(np.float64)).reshape(-1, 3)
    nearest = np.linalg.norm(dense[None] - points[:, None], axis=2).min(axis=1)
    assert np.all(np.sqrt(distance2) <= nearest + 1e-9)


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 1000))
def test_hull_normals_face_the_faces_about_them_where_any_direction_does(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = sphere(1)
    positions = (vertices * rng.uniform(0.3, 1.5, (len(vertices), 1))).astype(np.float32)
    across, normals = face_normals(positions, faces), hull_normals(positions, faces).astype(np.float64)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
    directions = sphere(4)[0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for vertex in range(len(positions)):
        around = across[np.any(faces == vertex, axis=1)]
        possible = (around @ directions.T).min(axis=0).max()
        if possible > 0.05:
            assert (around @ normals[vertex]).min() > 0.0


def seen_normals(positions, faces, towards, size, read):
    """(size^2, 3) normals an orthographic camera sees, zero where nothing; read(face, weights) -> normals."""
    x, y = np.meshgrid(*[(np.arange(size) + 0.5) / size * 2.1 - 1.05] * 2)
    right = np.cross([0.1, 1.0, 0.2], towards)
    right /= np.linalg.norm(right)
    origins = x.reshape(-1, 1) * right + y.reshape(-1, 1) * np.cross(towards, right) + 3.0 * towards
    face, weights, _ = Surface(positions, faces).shoot(origins, np.tile(-towards, (size * size, 1)), outer=True)
    normals = np.zeros((size * size, 3))
    hit = face >= 0
    normals[hit] = read(face[hit], weights[hit])
    return normals


@pytest.mark.heavy
def test_the_bunny_looks_as_its_original():
    bunny = trimesh.load(shared("bunny_closed.ply"), process=False)
    positions, faces, _ = normalised((np.asarray(bunny.vertices), np.asarray(bunny.faces, np.int32)))
    normals = vertex_normals(positions, faces)
    built = build_hull(positions, faces, 1000, quiet)
    hull = (built.positions, built.faces, hull_normals(built.positions, built.faces))
    maps = bake(hull, (positions, faces), texels=1024)
    assert maps.missed < 0.01 * maps.texel_count
    angles = []
    for eye in eyes(0, orthographic=4):
        original = seen_normals(
            positions, faces, eye[:3], 200, lambda f, w: bake_tiles.sampled_normals(positions, faces, normals, faces, f, w)
        )
        mapped = seen_normals(built.positions, built.faces, eye[:3], 200, lambda f, w: decoded(maps, f, w))
        both = (original != 0).any(axis=1) & (mapped != 0).any(axis=1)
        angles.append(degrees_between(mapped[both], original[both]))
    assert np.median(np.concatenate(angles)) < 3.0
    assert np.percentile(np.concatenate(angles), 90) < 15.0


# ---- colours


def srgb(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def linear(srgb_bytes):
    c = np.asarray(srgb_bytes, float) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def test_vertex_colours_are_found_in_linear_light(ball):
    (positions, faces), hull = ball
    colour = np.empty((len(positions), 4), np.uint8)
    colour[:, :3] = np.rint(srgb(positions * 0.45 + 0.5) * 255)
    colour[:, 3] = np.rint((positions[:, 0] * 0.5 + 0.5) * 200 + 55)
    maps = bake(hull, (positions, faces), {"corner_color": colour[faces]}, texels=512)
    face, weights = np.random.default_rng(5).integers(0, len(hull[1]), 2000), weights_inside(2000)
    at = on_hull(hull, face, weights)
    at /= np.linalg.norm(at, axis=1, keepdims=True)
    found = lookup(maps.color, maps.tile_uv, face, weights)
    assert np.abs(linear(found[:, :3]) - (at * 0.45 + 0.5)).max() < 0.02
    assert np.abs(found[:, 3] - ((at[:, 0] * 0.5 + 0.5) * 200 + 55)).max() < 3.0


def test_a_texture_is_found_with_v_upwards(ball):
    (positions, faces), hull = ball
    texture = np.full((64, 64, 4), 255, np.uint8)
    texture[..., 0] = np.arange(64)[None, :] * 4
    texture[..., 1] = np.arange(64)[:, None] * 4  # grows downwards
    uv = (positions[:, :2] * 0.4 + 0.5).astype(np.float32)
    maps = bake(hull, (positions, faces), {"corner_uv": uv[faces], "texture": texture}, texels=512)
    face, weights = np.random.default_rng(5).integers(0, len(hull[1]), 2000), weights_inside(2000)
    at = on_hull(hull, face, weights)
    at /= np.linalg.norm(at, axis=1, keepdims=True)
    found = lookup(maps.color, maps.tile_uv, face, weights)
    assert np.abs(found[:, 0] - ((at[:, 0] * 0.4 + 0.5) * 256 - 2)).max() < 4.0
    assert np.abs(found[:, 1] - ((0.5 - at[:, 1] * 0.4) * 256 - 2)).max() < 4.0
    assert np.allclose(found[:, 3], 255)


def test_texture_coordinates_repeat(ball):
    (positions, faces), hull = ball
    texture = np.random.default_rng(0).integers(0, 256, (8, 16, 4)).astype(np.uint8)
    uv = positions[faces][..., :2].astype(np.float32) * np.float32(0.25)
    near, far = (bake(hull, (positions, faces), {"corner_uv": uv + shift, "texture": texture}).color for shift in (0, np.float32([3, -5])))
    assert np.abs(near.astype(int) - far).max() <= 1


def test_corner_colours_tint_the_texture(ball):
    (positions, faces), hull = ball
    half = np.full((len(faces), 3, 4), 188, np.uint8)
    texture = np.full((4, 4, 4), 188, np.uint8)
    maps = bake(hull, (positions, faces), {"corner_color": half, "corner_uv": np.zeros((len(faces), 3, 2), np.float32), "texture": texture})
    inside = maps.color[maps.color[..., 3] > 0]
    assert np.all(np.abs(inside[:, :3].astype(int) - np.rint(srgb(linear(188) ** 2) * 255)) <= 1)
    assert np.all(np.abs(inside[:, 3].astype(int) - round(188 * 188 / 255)) <= 1)


def test_transparent_texels_lend_no_colour():
    face = np.zeros(1, np.int32)
    texture = np.array([[[255, 0, 0, 255], [0, 255, 0, 0]]], np.uint8)
    uv = np.full((1, 3, 2), 0.5, np.float32)
    levels = np.array([[0, texture.shape[1], texture.shape[0]]])
    weights, table = np.full((1, 3), 1 / 3), bake_color.linear_table()
    colour = bake_color.texture_colors(uv, texture.reshape(-1, 4), levels, face, weights, np.ones(1), table)
    assert np.allclose(colour, [[1.0, 0.0, 0.0, 0.5]])


def checker(side):
    texture = np.full((side, side, 4), 255, np.uint8)
    texture[..., :3] = (np.add.outer(np.arange(side), np.arange(side)) % 2 * 255)[..., None]
    return texture


def test_texture_finer_than_the_map_is_averaged_in_linear_light(ball):
    """Black and white in equal parts are half the light: byte 188. A mean of bytes is 128, and a single texel 0 or 255."""
    (positions, faces), hull = ball
    uv = (positions[:, :2] * 0.45 + 0.5).astype(np.float32)[faces]
    maps = bake(hull, (positions, faces), {"corner_uv": uv, "texture": checker(1024)}, texels=128)
    front = np.abs(face_normals(hull[0], hull[1])[:, 2]) > 0.7
    owner = TileLayout.of(maps.tile_uv, *maps.color.shape[1::-1]).owners()
    shown = maps.color[(owner >= 0) & front[owner]][:, :3].astype(int)
    assert len(shown) > 500
    assert np.abs(shown - 188).max() <= 12
    assert abs(shown.mean() - 188) <= 1.0


def test_texture_as_coarse_as_the_map_is_left_sharp(ball):
    (positions, faces), hull = ball
    texture = np.zeros((16, 16, 4), np.uint8)
    texture[:, 8:] = 255
    texture[..., 3] = 255
    uv = (positions[:, :2] * 0.5 + 0.5).astype(np.float32)[faces]
    maps = bake(hull, (positions, faces), {"corner_uv": uv, "texture": texture}, texels=512)
    inside = maps.color[maps.color[..., 3] > 0][:, 0]
    assert ((inside < 5) | (inside > 250)).mean() > 0.85


@pytest.mark.parametrize("size", [(8, 8), (7, 5), (2, 9), (1, 1), (6, 1)])
def test_halved_texture_keeps_the_light_and_the_opacity(size):
    rng = np.random.default_rng(3)
    texture = rng.integers(0, 256, (*size, 4)).astype(np.uint8)
    half = bake_color.halved(texture, bake_color.linear_table())
    assert half.shape == (max(size[0] // 2, 1), max(size[1] // 2, 1), 4)
    light = [(linear(image[..., :3]) * image[..., 3:] / 255.0).mean(axis=(0, 1)) for image in (texture, half)]
    assert np.abs(light[0] - light[1]).max() < 0.01
    assert abs(texture[..., 3].mean() - half[..., 3].mean()) < 0.6


def test_halved_checker_is_half_the_light():
    assert (bake_color.halved(checker(8), bake_color.linear_table()) == (188, 188, 188, 255)).all()


def test_where_all_is_transparent_the_colours_stay():
    """Pictures are opaque, so that black there would show."""
    texture = np.array([[[200, 100, 50, 0], [200, 100, 50, 0]], [[200, 100, 50, 0], [200, 100, 50, 0]]], np.uint8)
    assert (bake_color.halved(texture, bake_color.linear_table()) == (200, 100, 50, 0)).all()
    corners = np.full((1, 3, 4), (200, 100, 50, 0), np.uint8)
    found = bake_color.corner_colors(corners, np.zeros(1, np.int32), np.full((1, 3), 1 / 3), bake_color.linear_table())
    assert np.allclose(found, [[*linear([200, 100, 50]), 0.0]])


def test_without_appearance_there_is_no_colour_map(ball):
    mesh, hull = ball
    assert bake(hull, mesh).color is None
    assert bake(hull, mesh, {"corner_uv": np.zeros((len(mesh[1]), 3, 2), np.float32)}).color is None


# ---- progress


def test_progress_rises_to_one(ball, monkeypatch):
    (positions, faces), hull = ball
    monkeypatch.setattr("worker.bake.RAYS_AT_ONCE", 5000)
    seen = []
    bake_maps(*hull, positions, faces, vertex_normals(positions, faces), None, 256, seen.append)
    assert seen[0] == 0.0 and seen[-1] == 1.0 and len(seen) > 5
    assert seen == sorted(seen)


def test_cancelling_goes_through(ball):
    (positions, faces), hull = ball

    def cancel(fraction):
        if fraction > 0:
            raise CancelledError("the mesh was deleted")

    with pytest.raises(CancelledError):
        bake_maps(*hull, positions, faces, vertex_normals(positions, faces), None, 256, cancel)


def test_chunks_change_nothing(ball, monkeypatch):
    mesh, hull = ball
    whole = bake(hull, mesh)
    monkeypatch.setattr("worker.bake.RAYS_AT_ONCE", 1)
    assert np.array_equal(bake(hull, mesh).normal, whole.normal)


@pytest.mark.parametrize("count", [1, 4, 5, 64, 333])
def test_boxes_hold_every_triangle_once_and_halves_lie_beside_each_other(count):
    rng = np.random.default_rng(count)
    positions = rng.normal(size=(3 * count, 3)).astype(np.float32)
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    order, boxes = build_boxes(positions, faces)
    assert sorted(order) == list(range(count))
    leaves, centres = len(boxes) // 2, positions[faces].astype(np.float64).mean(axis=1)
    for node in range(1, 2 * leaves):
        depth = node.bit_length() - 1
        size = LEAF * leaves >> depth
        start = (node - (1 << depth)) * size
        inside, half = order[start : start + size], order[start : start + size // 2]
        if not len(inside):
            continue
        corners = positions[faces[inside]].reshape(-1, 3)
        assert np.array_equal(boxes[node], [*corners.min(axis=0), *corners.max(axis=0)])
        others = order[start + size // 2 : start + size]
        if node < leaves and len(others):
            axis = np.argmax(np.ptp(centres[inside], axis=0))
            assert centres[half, axis].max() <= centres[others, axis].min()
