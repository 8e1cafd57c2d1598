import numpy as np
import pytest

from client.shapes import catmull_clark, three_holed_torus, torus_knot
from geometry.topology import build_edges, face_normals
from tests.oracles_hull import winding_numbers

KNOT_FACES, HOLES_FACES = 185_856, 188_416  # Silhouette Clipping, Table 1


def euler(vertices, faces):
    return len(vertices) - len(build_edges(faces).vertices) + len(faces)


@pytest.mark.parametrize(("made", "count", "characteristic"), [(torus_knot, KNOT_FACES, 0), (three_holed_torus, HOLES_FACES, -4)])
def test_models_have_the_papers_face_counts_and_are_closed_with_their_genus(made, count, characteristic):
    vertices, faces = made()
    starts, ends = faces.ravel().astype(np.int64), np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    sides, turned = (np.unique(a << 32 | b) for a, b in ((starts, ends), (ends, starts)))
    assert len(faces) == count
    assert len(sides) == faces.size and np.array_equal(sides, turned)
    assert euler(vertices, faces) == characteristic


def test_three_holed_torus_is_embedded_and_faces_outward():
    vertices, faces = three_holed_torus(2)
    middles = vertices[faces].mean(axis=1)
    step = 1e-4 * face_normals(vertices, faces)
    assert np.allclose(winding_numbers(vertices, faces, middles - step), 1.0)
    assert np.allclose(winding_numbers(vertices, faces, middles + step), 0.0)


def test_three_holed_torus_has_no_needles():
    vertices, faces = three_holed_torus()
    corners = vertices[faces]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = (ahead * behind).sum(-1) / np.linalg.norm(ahead, axis=-1) / np.linalg.norm(behind, axis=-1)
    assert np.degrees(np.arccos(cosine)).min() > 20.0


def test_catmull_clark_of_a_cube_is_the_textbooks():
    corners = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    quads = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)], np.int32)
    vertices, split = catmull_clark(corners, quads)
    assert (len(vertices), len(split)) == (26, 24)
    assert np.allclose(vertices[:8], corners * 5.0 / 9.0)
    assert np.allclose(np.sort(np.abs(vertices[8:20]), axis=1), [0.0, 0.75, 0.75])
    assert np.allclose(np.sort(np.abs(vertices[20:]), axis=1), [0.0, 0.0, 1.0])
