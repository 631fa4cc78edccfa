import numpy as np
import pytest
import trimesh

from spinpipe.stages.ingest.vehicles import VEHICLES, vehicle_mesh


@pytest.mark.parametrize("kind", VEHICLES)
def test_is_closed_upright_and_of_a_real_size(kind):
    vertices, faces = vehicle_mesh(kind)
    shells = trimesh.Trimesh(vertices, faces, process=False).split(only_watertight=False)
    assert len(shells) == 5  # body and wheels
    assert all(shell.is_watertight and shell.volume > 0 for shell in shells)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    assert np.allclose((low + high)[:2] / 2, 0, atol=1e-9)
    assert low[2] == pytest.approx(0, abs=1e-9)
    length, width, height = high - low
    assert 3.9 < length < 5.4
    assert 1.7 < width < 2.0
    assert 1.4 < height < 2.0


@pytest.mark.parametrize("kind", VEHICLES)
def test_front_is_lower_than_the_middle_and_sides_are_alike(kind):
    vertices, _ = vehicle_mesh(kind)
    length = np.ptp(vertices[:, 0])
    nose = vertices[vertices[:, 0] > 0.3 * length, 2].max()
    assert nose < 0.8 * vertices[:, 2].max()
    mirrored = np.sort(np.round(vertices * [1, -1, 1], 6).view([("", float)] * 3).ravel())
    body = np.round(vertices, 6).view([("", float)] * 3).ravel()
    assert np.isin(body, mirrored).mean() > 0.6  # the body; wheels have no centre vertices


def test_names_those_there_are():
    with pytest.raises(ValueError, match="saloon"):
        vehicle_mesh("tank")
