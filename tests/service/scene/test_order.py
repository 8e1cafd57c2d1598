"""The order of layers, against every hit of many rays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.scene import matrix_of
from service.camera import resolve_camera
from service.scene.order import Group, Placed, Sight, sight_of, sort_groups
from service.scene.place import own_view, place, sphere_around
from tests.service.scene.made import rotation, scene, turned
from tests.service.scene.oracles import depths, rays

FRONT = {"eye": [0.0, 0.0, 10.0]}
FLAT = {"eye": [0.0, 0.0, 10.0], "projection": "orthographic", "height": 6.0}


def placed(request, assets):
    """(objects, eye, frame) as `sort_groups` takes them."""
    standing = [place(asset, matrix_of(o.transform), "") for o, asset in zip(request.objects, assets, strict=True)]
    around = sphere_around(standing)
    size = (request.width, request.height)
    objects = [
        Placed(i, asset, placement, own_view(asset, placement, request.camera, size, around))
        for i, (asset, placement) in enumerate(zip(assets, standing, strict=True))
    ]
    return objects, resolve_camera(request.camera, around, *size).eye, around


def groups_of(objects, **fields):
    return sort_groups(*placed(*scene(objects, **fields)))


def sight(objects, **fields):
    (a, b), eye, frame = placed(*scene(objects, **fields))
    return sight_of(a, b, eye, frame)


def check_order(request, assets, groups, samples=40):
    """No ray meets an object of an earlier group before one of a later group. Returns how many pairs of hits were compared."""
    columns, rows = (a.ravel() for a in np.meshgrid(*((np.arange(samples) + 0.37) / samples * s for s in (request.width, request.height))))
    hit = depths(request, assets, *rays(request, assets, columns, rows))
    size = sphere_around([p.placement for p in placed(request, assets)[0]]).scale
    compared = 0
    for later in range(len(groups)):
        for earlier in range(later):
            for i in groups[later].members:
                for j in groups[earlier].members:
                    both = np.isfinite(hit[:, i, 0]) & np.isfinite(hit[:, j, 0])
                    compared += int(both.sum())
                    assert (hit[both, i, 1] <= hit[both, j, 0] + 1e-6 * size).all(), (i, j)
    return compared


@pytest.mark.parametrize("camera", [FRONT, FLAT])
def test_objects_in_a_row_are_drawn_from_the_far_end(camera):
    objects = [("ball", {"translate": [0.1 * z, 0.0, 2.5 * z]}) for z in (0, -2, 1, -1)]
    assert [group.members for group in groups_of(objects, camera=camera)] == [(1,), (3,), (0,), (2,)]


def test_side_by_side_needs_no_order():
    assert sight([("ball", {"translate": [-2, 0, 0]}), ("ball", {"translate": [2, 0, 0]})], camera=FRONT) is Sight.FREE


@pytest.mark.parametrize("camera", [FRONT, FLAT])
def test_the_nearer_of_two_is_before_whatever_their_place_in_the_request(camera):
    near, far = ("ring", {"translate": [0.2, 0, 2]}), ("box", {"translate": [0, 0, -2]})
    assert sight([near, far], camera=camera) is Sight.BEFORE
    assert sight([far, near], camera=camera) is Sight.BEHIND


def test_a_ball_over_the_hole_of_a_ring_is_not_tangled():
    """Their boxes meet, and so would their clipping hulls; a plane between the meshes is there."""
    ring = ("ring", {"rotate": turned(0)})
    assert sight([ring, ("ball", {"translate": [0, 0, 0.75], "scale": 0.5})], camera=FRONT) is Sight.BEHIND


def test_a_ball_in_the_hole_of_a_ring_is_tangled():
    assert sight([("ring", {}), ("ball", {"scale": 0.4})], camera=FRONT) is Sight.TANGLED


@pytest.mark.parametrize("place", [0.0, 1e6])
@pytest.mark.parametrize(
    ("step", "expected"),
    [([1, 0, 0], Sight.BEHIND), ([0, 0, -1], Sight.BEFORE), ([0.5, 0.2, -1], Sight.BEFORE), ([0.3, 1, 0.4], Sight.BEHIND)],
)
def test_boxes_that_touch_are_not_tangled(step, expected, place):
    camera = {"eye": [place + 4.0, 3.0, 9.0], "target": [place, 0, 0]}
    objects = [("box", {"translate": [place, 0, 0]}), ("box", {"translate": [place + step[0], step[1], step[2]]})]
    assert sight(objects, camera=camera) is expected


def test_boxes_that_run_into_one_another_are_tangled():
    assert sight([("box", {}), ("box", {"translate": [0.9999, 0, 0]})], camera={"eye": [4.0, 3.0, 9.0]}) is Sight.TANGLED


@pytest.mark.parametrize("turn", [0, 1, 2])
def test_a_group_comes_before_what_hides_one_of_its_members(turn):
    """Members of a group reach themselves; counted without that, the one object before them tied with them."""
    objects = [("ball", {"translate": [0.1, 0, 4]}), ("box", {}), ("box", {"translate": [0.5, 0, 0]})]
    groups = groups_of(objects[turn:] + objects[:turn], camera=FRONT)
    assert [len(group.members) for group in groups] == [2, 1]


def test_the_same_object_twice_is_one_group():
    assert groups_of([("knot", {}), ("ball", {"translate": [0, 0, -9]}), ("knot", {})], camera=FRONT) == [
        Group((1,), ()),
        Group((0, 2), ((0, 2),)),
    ]


def test_interlocked_rings_are_one_group_at_its_place_in_the_order():
    rings = [("ring", {}), ("ring", {"translate": [1, 0, 0], "rotate": turned(90, (1, 0, 0))})]
    far = ("ball", {"translate": [0.5, 0, -5], "scale": 0.5})
    near = ("ball", {"translate": [0.5, 0, 5], "scale": 0.3})
    assert [g.members for g in groups_of([*rings, far, near], camera=FRONT)] == [(2,), (0, 1), (3,)]


def bars():
    """Three bars, each before the next and behind the one before it, as seen from +z."""
    made = []
    for k in range(3):
        angle = 120.0 * k
        a = np.radians(angle)
        along, across = np.array([np.cos(a), np.sin(a), 0.0]), np.array([-np.sin(a), np.cos(a), 0.0])
        linear = np.stack([4.0 * along + [0, 0, 1.2], 0.4 * across, [0.0, 0.0, 0.2]], axis=1)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = linear, -linear @ [0.5, 0.5, 0.5] + 0.8 * across
        made.append(("box", matrix.tolist()))
    return made


@pytest.mark.parametrize("camera", [FRONT, FLAT])
def test_bars_that_hide_each_other_in_a_circle_are_one_group_without_touching(camera):
    ball = ("ball", {"translate": [0, 0, -4]})
    groups = groups_of([*bars(), ball], camera=camera)
    assert groups == [Group((3,), ()), Group((0, 1, 2), ())]


def test_bars_seen_from_the_side_are_no_circle():
    groups = groups_of(bars(), camera={"eye": [0.0, -30.0, 0.0], "up": [0.0, 0.0, 1.0]})
    assert len(groups) > 1


@pytest.mark.parametrize("camera", [{"eye": [0.0, 0.0, 0.3], "target": [0, 0, -5]}, {"eye": [0.3, 0.0, 0.0], "target": [0, 0, -5]}])
def test_objects_about_the_eye_are_in_order(camera):
    """The eye is inside a ring, and part of the ring is behind it."""
    objects = [("ring", {"scale": 1.5}), ("ball", {"translate": [0, 0, -4]}), ("box", {"translate": [0, 0, -8], "scale": 3})]
    request, assets = scene(objects, camera=camera)
    groups = sort_groups(*placed(request, assets))
    assert [g.members for g in groups] == [(2,), (1,), (0,)]


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_order_does_not_depend_on_units_or_place(scale, offset):
    def moved(x, y, z):
        return [scale * (offset + c) for c in (x, y, z)]

    objects = [("ball", {"translate": moved(0.1 * z, 0, 2.5 * z), "scale": scale}) for z in (0, -2, 1, -1)]
    camera = {"eye": moved(0, 0, 10), "target": moved(0, 0, 0)}
    assert [group.members for group in groups_of(objects, camera=camera)] == [(1,), (3,), (0,), (2,)]


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_no_ray_contradicts_the_order_of_random_objects(seed):
    rng = np.random.default_rng(seed)
    objects = []
    for _ in range(rng.integers(2, 8)):
        scale = (rng.uniform(0.3, 1.2, 3) * rng.choice([-1, 1], 3)).tolist()
        translate = rng.uniform(-2.5, 2.5, 3).tolist()
        objects.append((str(rng.choice(["ball", "box", "ring"])), {"translate": translate, "rotate": rotation(rng), "scale": scale}))
    camera = [FRONT, FLAT, {"eye": rng.uniform(-3, 3, 3).tolist(), "target": [0, 0, 0.1], "up": [0.1, 1, 0.2], "fov_y_deg": 80}][seed % 3]
    request, assets = scene(objects, camera=camera)
    groups = sort_groups(*placed(request, assets))
    assert sorted(m for g in groups for m in g.members) == list(range(len(objects)))
    check_order(request, assets, groups, 20)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_balls_that_are_apart_are_all_layers_of_their_own(seed):
    rng = np.random.default_rng(seed)
    centres, radii = rng.uniform(-3, 3, (12, 3)), rng.uniform(0.2, 0.9, 12)
    kept = []
    for i in range(12):
        if all(np.linalg.norm(centres[i] - centres[j]) > (radii[i] + radii[j]) * 1.001 for j in kept):
            kept.append(i)
    objects = [("ball", {"translate": centres[i].tolist(), "rotate": rotation(rng), "scale": radii[i]}) for i in kept]
    camera = FLAT if seed % 2 else {"eye": [0, 0, 8]}
    request, assets = scene(objects, camera=camera)
    groups = sort_groups(*placed(request, assets))
    assert [len(g.members) for g in groups] == [1] * len(kept)
    check_order(request, assets, groups, 20)


def test_what_lies_between_members_of_a_group_is_a_member():
    """A rod through a ring; a ball that the rod hides and that hides the ring."""
    ring, rod = ("ring", {"scale": 1.5}), ("box", {"translate": [-0.1, -0.1, -3], "scale": [0.2, 0.2, 9]})
    ball = ("ball", {"translate": [0.6, 0, 2], "scale": 0.3})
    camera = {"eye": [-3.0, 0.0, 10.0]}
    assert sight([rod, ball], camera=camera) is Sight.BEFORE
    assert sight([ball, ring], camera=camera) is Sight.BEFORE
    far = ("ball", {"translate": [0, 0, -6]})
    assert groups_of([ring, far, rod, ball], camera=camera) == [Group((1,), ()), Group((0, 2, 3), ((0, 2),))]
