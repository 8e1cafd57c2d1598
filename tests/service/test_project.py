from itertools import pairwise

import numpy as np
import pytest
import trimesh

from schemas.conventions import Frame
from schemas.render import Camera, Orbit, OrbitCamera
from service.camera import project, resolve_camera, to_pixels
from service.silhouette import project as projection
from service.silhouette.coverage import coverage_mask
from service.silhouette.project import pixel_matrix, project_edges, surrounding_layers
from tests import meshes
from tests.service.oracles import covered_by_rays, silhouette, supersampled

UNIT = Frame((0.0, 0.0, 0.0), 1.0)
SAMPLES = 12


def looking(eye, target, fov=60.0, size=(20, 20), up=(0.0, 1.0, 0.0)):
    return resolve_camera(Camera(eye=list(eye), target=list(target), up=list(up), fov_y_deg=fov), UNIT, *size)


def mask_and_truth(view, positions, faces, surrounded=False):
    edges = silhouette(positions, faces, view.eye)
    segments = project_edges(view, positions, edges)
    assert np.all(np.isfinite(segments))
    base = surrounding_layers(view, positions, faces, segments) if surrounded else 0
    mask = coverage_mask(segments, view.width, view.height, base=base).mask / 255.0
    return mask, covered_by_rays(view, positions, faces, SAMPLES)


def assert_same_picture(mask, truth):
    """Sampling leaves an edge within a sample's width of its pixel undecided: a few of SAMPLES^2."""
    assert np.abs(mask - truth).max() <= 2.0 / SAMPLES
    assert np.abs(mask - truth).mean() <= 0.01


SHAPES = {
    "sphere": meshes.sphere(1),
    "bumpy": meshes.bumpy_sphere(2),
    "torus": meshes.torus(16, 8),
    "knot": meshes.knot(48, 5),
    "cube": meshes.cube(1),
    "nested": meshes.joined(meshes.sphere(1), meshes.sphere(1, 0.4, (1.2, 0.3, 0.0))),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("orthographic", [False, True])
def test_mask_is_the_supersampled_original(name, orthographic):
    positions, faces, frame = meshes.normalised(SHAPES[name])
    rng = np.random.default_rng(len(name))
    for _ in range(3):
        eye = frame.to_model(rng.normal(size=3) * 2.0)
        camera = Camera(
            eye=list(eye),
            target=list(frame.centre),
            fov_y_deg=55.0,
            projection="orthographic" if orthographic else "perspective",
            height=2.0 * frame.scale,
        )
        view = resolve_camera(camera, frame, 24, 18)
        mask, truth = mask_and_truth(view, positions, faces, surrounded=np.linalg.norm(view.eye[:3]) < 1.0)
        assert_same_picture(mask, truth)


def test_silhouette_of_the_front_has_its_inside_on_the_right_of_falling_edges():
    positions, faces, _ = meshes.normalised(meshes.sphere(2))
    view = looking((0, 0, 3), (0, 0, 0))
    segments = project_edges(view, positions, silhouette(positions, faces, view.eye))
    falling = segments[segments[:, 3] > segments[:, 1]]
    assert np.all(falling[:, [0, 2]] < 10.0)


@pytest.mark.parametrize("eye", [(0.0, 0.3, 3.0), (0.6, 0.5, 1.2)], ids=["whole", "cropped"])
def test_edges_shared_out_come_in_the_order_of_one_core(monkeypatch, eye):
    positions, faces, _ = meshes.normalised(SHAPES["knot"])
    view = looking(eye, (0.0, 0.0, 0.0) if eye[2] > 2.0 else (0.5, 0.0, 0.0), fov=60.0 if eye[2] > 2.0 else 30.0)
    edges = silhouette(positions, faces, view.eye)
    alone = project_edges(view, positions, edges)
    monkeypatch.setattr(projection, "EDGES_A_CORE", 8)
    for count in (2, 3, 5):
        monkeypatch.setattr(projection, "cores", lambda count=count: count)
        assert np.array_equal(project_edges(view, positions, edges), alone)
    assert (len(alone) < len(edges)) == (eye[2] < 2.0)


@pytest.mark.parametrize("name", ["torus", "knot", "bumpy", "cube"])
@pytest.mark.parametrize("seed", range(4))
def test_eye_outside_the_hull_with_parts_behind_it(name, seed):
    positions, faces, _ = meshes.normalised(SHAPES[name])
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    # just outside a plane that has the whole mesh on one side, looking along it
    eye = direction * (float((positions @ direction).max()) + 0.02) + np.cross(direction, rng.normal(size=3)) * 0.3
    along = np.cross(direction, rng.normal(size=3))
    view = looking(eye, eye + along / np.linalg.norm(along) - 0.6 * direction, fov=120.0)
    assert (project(view, positions)[:, 3] < 0).any()
    mask, truth = mask_and_truth(view, positions, faces)
    assert truth.max() > 0.0
    assert_same_picture(mask, truth)


@pytest.mark.parametrize("seed", range(6))
def test_eye_inside_the_hull_needs_the_layers_around_it(seed):
    """In the hole of a torus, and among the strands of a knot."""
    positions, faces, _ = meshes.normalised(SHAPES["torus"] if seed % 2 else SHAPES["knot"])
    rng = np.random.default_rng(seed)
    eye = np.zeros(3) if seed < 2 else rng.uniform(-0.12, 0.12, 3)
    view = looking(eye, eye + rng.normal(size=3), fov=110.0)
    mask, truth = mask_and_truth(view, positions, faces, surrounded=True)
    assert truth.max() > 0.0
    assert_same_picture(mask, truth)


def test_a_surface_that_fills_the_view_covers_all_of_it():
    """In the hole of a torus, close to its wall: no edge of the silhouette is in view."""
    positions, faces, _ = meshes.normalised(SHAPES["torus"])
    inner = positions[np.argmin(np.linalg.norm(positions, axis=1))].astype(float)
    view = looking(inner * 0.9, inner, fov=20.0, up=(0.0, 0.0, 1.0))
    mask, _ = mask_and_truth(view, positions, faces, surrounded=True)
    assert np.all(mask == 1.0)


def test_nothing_is_left_when_all_of_it_is_behind():
    positions, faces, _ = meshes.normalised(SHAPES["bumpy"])
    view = looking((0, 0, 2), (0, 0, 5))
    segments = project_edges(view, positions, silhouette(positions, faces, view.eye))
    assert not coverage_mask(segments, 20, 20).mask.any()


@pytest.mark.parametrize("fov", [1e-3, 1.0, 170.0, 179.9])
def test_fields_of_view_from_needle_to_half_space(fov):
    positions, faces, _ = meshes.normalised(SHAPES["bumpy"])
    view = resolve_camera(OrbitCamera(orbit=Orbit(azimuth_deg=20.0, fov_y_deg=fov)), UNIT, 24, 24)
    assert_same_picture(*mask_and_truth(view, positions, faces))


def test_a_vertex_in_the_eye_plane_exactly():
    positions, faces, _ = meshes.normalised(meshes.cube(1))
    top = float(positions[:, 2].max())
    view = looking((0.0, 0.0, top + 0.25), (1.0, 0.0, top + 0.25), up=(0.0, 0.0, 1.0), fov=120.0)
    shifted = positions + np.float32([positions[0, 0], 0.0, 0.0])
    assert (project(view, shifted)[:, 3] == 0.0).any()
    assert_same_picture(*mask_and_truth(view, shifted, faces))


def test_edges_far_off_the_axis_are_clipped_without_losing_digits():
    """A wall that runs from beside the eye to the horizon: its ends are 1e10 pixels away."""
    v, faces = meshes.cube(1)
    positions = ((v - (0.5, 0.5, 0.5)) * (0.2, 0.4, 1.6) + (0.3, 0.0, 0.0)).astype(np.float32)
    view = looking((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), fov=90.0)
    assert_same_picture(*mask_and_truth(view, positions, faces))


def test_scale_and_offset_of_the_model_do_not_matter():
    mesh = meshes.bumpy_sphere(2)
    positions, faces, _ = meshes.normalised(mesh)
    expected = None
    for scale, offset in ((1.0, 0.0), (1e-12, 0.0), (1e12, 0.0), (1.0, 1e7)):
        frame = Frame((offset, -offset, offset), scale)
        eye = frame.to_model(np.array([0.5, 1.0, 2.5]))
        view = resolve_camera(Camera(eye=list(eye), target=list(frame.centre)), frame, 32, 32)
        mask = coverage_mask(project_edges(view, positions, silhouette(positions, faces, view.eye)), 32, 32).mask.astype(int)
        expected = mask if expected is None else expected
        assert np.abs(mask - expected).max() <= 1


def test_pixel_matrix_agrees_with_projecting_and_dividing():
    positions, _, _ = meshes.normalised(SHAPES["bumpy"])
    view = looking((1, 2, 3), (0, 0.1, 0), size=(30, 20))
    m = pixel_matrix(view)
    homogeneous = positions @ m[:, :3].T + m[:, 3]
    assert np.allclose(homogeneous[:, :2] / homogeneous[:, 2:], to_pixels(view, project(view, positions)), atol=1e-9)


def real(name):
    mesh = trimesh.load(meshes.shared(name), process=False)
    return meshes.normalised((np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)))


@pytest.mark.heavy
def test_mask_of_a_real_mesh_is_the_original_supersampled():
    """The bar of the `coverage` rung: 0.02 mean error in pixels of the edge, one in 10,000 of the others not exact."""
    positions, faces, frame = real("bunny_closed.ply")
    errors, wrong = [], []
    for azimuth, elevation in ((30.0, 20.0), (145.0, -35.0), (260.0, 70.0)):
        view = resolve_camera(OrbitCamera(orbit=Orbit(azimuth_deg=azimuth, elevation_deg=elevation)), frame, 512, 512)
        mask = coverage_mask(project_edges(view, positions, silhouette(positions, faces, view.eye)), 512, 512).mask / 255.0
        truth = supersampled(to_pixels(view, project(view, positions)), faces, 512, 512, 16)
        edge = (truth > 0.0) & (truth < 1.0)
        errors.append(np.abs(mask - truth)[edge].mean())
        wrong.append((mask != truth)[~edge].mean())
        assert np.abs(mask - truth).max() <= 0.06
    assert np.mean(errors) <= 0.005
    assert np.mean(wrong) <= 1e-4


@pytest.mark.heavy
def test_a_smaller_picture_of_a_real_mesh_is_the_mean_of_the_larger_one():
    positions, faces, frame = real("bunny_closed.ply")
    masks = []
    for size in (512, 128, 32):
        view = resolve_camera(OrbitCamera(orbit=Orbit(azimuth_deg=40.0, elevation_deg=15.0)), frame, size, size)
        masks.append(coverage_mask(project_edges(view, positions, silhouette(positions, faces, view.eye)), size, size).mask / 255.0)
    for fine, small in pairwise(masks):
        mean = fine.reshape(len(small), 4, len(small), 4).mean(axis=(1, 3))
        assert np.abs(mean - small).max() <= 0.02
