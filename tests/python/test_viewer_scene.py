"""What a scene holds, whatever draws it: models, joints, energy, and what a Stage shows."""

from __future__ import annotations

import argparse

import numpy as np
import pytest

import novaphy
from novaphy import viewer as viewers


def test_a_stage_draws_iterations_as_asked():
    calls = []

    class Recorder(viewers.Viewer):
        """Keeps what it was told."""

        def log_lines(self, name, starts, ends, colors, width=0.01, hidden=False):
            """Keep the lines."""
            calls.append((name, np.array(starts), np.broadcast_to(colors, np.shape(starts))))

        def log_state(self, state):
            """Keep the time."""
            calls.append(("state", self.time))

    args = argparse.Namespace(refresh=None, record=None, live=False)
    model = novaphy.ModelBuilder().finalize()
    state = model.state()
    with viewers.Stage(args, model, refresh=2, viewers=[Recorder()]) as stage:
        for k in range(80):
            points = np.float32([[0, 0, k], [1, 0, k], [2, 0, k]])
            stage.iteration(
                k, 1.0 / (k + 1), lambda: [(0.0, state), (0.5, state)], {"path": points}
            )
    assert [t for name, t, *_ in (c for c in calls if c[0] == "state")] == [0.0, 0.5] * 40
    present = [c for c in calls if c[0] == "path"]
    assert [int(c[1][0, 2]) for c in present] == list(range(0, 80, 2))
    earlier = [c for c in calls if c[0] == "path/earlier"]
    assert len(earlier) == 39 and len(earlier[-1][1]) == 32 * 2
    heights, shades = earlier[-1][1][:, 2], earlier[-1][2]
    assert heights[0] == 14 and heights[-1] == 76  # the last 32, the oldest first
    brightness = shades.sum(axis=1)
    assert np.all(np.diff(brightness) <= 0) and brightness[0] > brightness[-1] + 0.4
    assert not np.allclose(present[-1][2][0], shades[-1], atol=0.2)


def test_the_axes_of_joints_are_drawn():
    builder = novaphy.ModelBuilder()
    link = builder.add_link(xform=((0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)), mass=1.0)
    builder.add_shape_box(link, hx=0.1, hy=0.1, hz=0.1)
    turn = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))  # z by 90 degrees: x becomes y
    joint = builder.add_joint_revolute(
        -1, link, axis=(1.0, 0.0, 0.0), parent_xform=((0.0, 0.0, 1.0), turn)
    )
    builder.add_articulation([joint])
    model = builder.finalize()
    with novaphy.ViewerHTML(None) as viewer:
        viewer.set_model(model)
        assert "model/joints" not in viewer.scene.lines
        viewer.show_joints = True
        viewer.log_state(model.state())
        lines = viewer.scene.lines["model/joints"]
        half = 0.5 * (lines.ends.values - lines.starts.values)
        middle = 0.5 * (lines.ends.values + lines.starts.values)
        np.testing.assert_allclose(half, [[0.0, 0.06, 0.0]], atol=1e-6)
        np.testing.assert_allclose(middle, [[0.0, 0.0, 1.0]], atol=1e-6)


def test_the_energy_is_that_of_gravity_and_motion():
    builder = novaphy.ModelBuilder()
    half = (0.1, 0.2, 0.3)
    turned = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # x by 90 degrees: the body's y is up
    body = builder.add_body(xform=((1.0, 2.0, 3.0), turned), mass=0.0)
    builder.add_shape_box(body, hx=half[0], hy=half[1], hz=half[2])
    builder.body_qd[body] = (1.0, 2.0, 2.0, 0.0, 0.0, 5.0)
    builder.add_particle(pos=(0.0, 0.0, 2.0), vel=(0.0, 3.0, 4.0), mass=2.0)
    model = builder.finalize()
    mass = 8 * half[0] * half[1] * half[2] * 1000.0
    about_y = mass / 3.0 * (half[0] ** 2 + half[2] ** 2)
    expected = mass * (0.5 * 9.0 + 9.81 * 3.0) + 0.5 * about_y * 25.0 + 2.0 * (12.5 + 9.81 * 2.0)
    with novaphy.ViewerHTML(None) as viewer:
        viewer.set_model(model)
        viewer.show_energy = True
        viewer.log_state(model.state())
        assert viewer.texts()[1] == f"energy {viewer._energy:.6g} J"
        assert viewer._energy == pytest.approx(expected, rel=1e-5)


def test_a_changed_object_is_never_taken_for_the_old_one():
    from novaphy.viewer._scene import Part, Scene

    seen = set()
    for _ in range(1000):  # parts come and go, at the same address
        part = Part(np.zeros(3, np.float32))
        assert part.revision not in seen
        seen.add(part.revision)
        part.set(np.ones(3, np.float32))
        assert part.revision not in seen
        seen.add(part.revision)
        part.set(np.ones(3, np.float32))
        assert part.revision in seen
    scene = Scene()
    scene.put_lines("a", *np.zeros((3, 4, 3), np.float32), 0.1)
    before = scene.lines["a"].starts.revision
    scene.put_lines("a", *np.zeros((3, 4, 3), np.float32), 0.1)
    assert scene.lines["a"].starts.revision == before


def test_the_text_has_curves_and_images(tmp_path):
    from novaphy.viewer._overlay import curve_coverage, overlay, text_coverage

    with novaphy.ViewerHTML(None) as viewer:
        scene = viewer.scene
    plain = overlay(scene, ["time 1"], "loss")
    scene.scalars["loss"] = [4.0, 2.0, 1.0]
    with_curve = overlay(scene, ["time 1"], "loss")
    scene.images["camera"] = np.full((30, 40, 3), (10, 200, 30), np.uint8)
    with_image = overlay(scene, ["time 1"], "loss")
    scene.curves["tail"] = np.arange(5.0)
    everything = overlay(scene, ["time 1"], "loss")
    heights = [box.shape[0] for box in (plain, with_curve, with_image, everything)]
    assert heights == sorted(set(heights))
    assert np.count_nonzero((with_image == (10, 200, 30, 255)).all(axis=2)) == 1200
    curve = curve_coverage([4.0, 2.0, 1.0])  # on a logarithmic scale: a straight line
    rows = (np.arange(len(curve))[:, None] * curve).sum(axis=0) / curve.sum(axis=0)
    straight = np.linspace(rows[2], rows[-3], len(rows) - 4)
    np.testing.assert_allclose(rows[2:-2], straight, atol=0.8)
    assert rows[0] < rows[-1]  # it falls
    assert text_coverage(["a", "bc"]).shape == (34, 16)
    assert np.array_equal(text_coverage(["²"]), text_coverage(["?"]))


def test_contacts_are_points_with_a_normal():
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    body = builder.add_body(xform=((0.0, 0.0, 0.099), (0.0, 0.0, 0.0, 1.0)), mass=1.0)
    only_shapes = novaphy.ShapeConfig(has_particle_collision=False)
    builder.add_shape_box(body, hx=0.1, hy=0.2, hz=0.1, cfg=only_shapes)
    builder.add_particle(pos=(1.0, 0.0, 0.05), vel=(0.0, 0.0, 0.0), mass=1.0, radius=0.1)
    model = builder.finalize()
    state = model.state()
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    with novaphy.ViewerHTML(None) as viewer:
        with pytest.raises(ValueError, match="set_model"):
            viewer.log_contacts(contacts, state)
        viewer.set_model(model)
        viewer.log_contacts(contacts, state)
        points = viewer.scene.instances["contacts/points"].poses.values[:, :3]
        lines = viewer.scene.lines["contacts/arrows"]
        normals = (lines.ends.values - lines.starts.values) / 0.1
        np.testing.assert_array_equal(points, lines.starts.values)
        corners = sorted(tuple(np.round(p, 4)) for p in points[:4])
        assert corners == [(x, y, 0.0) for x in (-0.1, 0.1) for y in (-0.2, 0.2)]
        np.testing.assert_allclose(points[4:], [[1.0, 0.0, 0.05]], atol=1e-6)
        np.testing.assert_allclose(normals, np.tile([0.0, 0.0, 1.0], (5, 1)), atol=1e-6)
