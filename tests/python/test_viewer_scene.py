"""What a scene holds, whatever draws it: models, joints, energy, and what a Stage shows."""

from __future__ import annotations

import argparse
import tracemalloc

import numpy as np
import pytest

import novaphy
from novaphy import viewer as viewers
from novaphy.viewer._drag import Drag
from novaphy.viewer._scene_viewer import SceneViewer


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


def walk(viewer, places):
    """Follow a body that is at places (m) in turn, from a camera that looks at the origin."""
    builder = novaphy.ModelBuilder()
    body = builder.add_body(mass=1.0)
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    model = builder.finalize()
    state = model.state()
    viewer.set_model(model)
    viewer.look_at((3.0, -3.0, 2.0), (0.0, 0.0, 0.5))
    viewer.follow(body)
    for k, place in enumerate(places):
        state.body_q.assign(np.float32([[*place, 0.0, 0.0, 0.0, 1.0]]))
        viewer.begin_frame(0.1 * k)
        viewer.log_state(state)
        viewer.end_frame()


WAY = ((1.0, 0.0, 1.0), (1.5, 0.2, 1.4), (4.0, -1.0, 0.7))


def test_a_camera_goes_along_with_a_body_on_the_level(tmp_path):
    viewer = SceneViewer()
    walk(viewer, WAY)
    np.testing.assert_allclose(viewer.camera.target, (3.0, -1.0, 0.5), atol=1e-6)
    np.testing.assert_allclose(viewer.camera.pos, (6.0, -4.0, 2.0), atol=1e-6)
    viewer.camera.orbit(30.0, 0.0)  # the user turns it: it goes on from there
    turned = viewer.camera.pos - viewer.camera.target
    viewer.log_state_arrays({"body_q": np.float32([[5.0, -1.0, 3.0, 0, 0, 0, 1]])})
    np.testing.assert_allclose(viewer.camera.target, (4.0, -1.0, 0.5), atol=1e-6)
    np.testing.assert_allclose(viewer.camera.pos - viewer.camera.target, turned, atol=1e-6)
    for place in (np.nan, 7.0):  # neither what is not finite, nor after the end
        viewer.follow(None if place == 7.0 else 0)
        viewer.log_state_arrays({"body_q": np.float32([[place, -1.0, 3.0, 0, 0, 0, 1]])})
        np.testing.assert_allclose(viewer.camera.target, (4.0, -1.0, 0.5), atol=1e-6)

    with novaphy.ViewerFile(tmp_path / "run.nprec") as recorder:
        walk(recorder, WAY)
    again = novaphy.ViewerFile(tmp_path / "other.nprec", auto_save=False)
    again.load_recording(tmp_path / "run.nprec")
    for from_start in (False, True):
        viewer = SceneViewer()
        again.show_start(viewer)
        for k in (2,) if from_start else range(3):
            again.show_frame(viewer, k, from_start)
        np.testing.assert_allclose(viewer.camera.target, (3.0, -1.0, 0.5), atol=1e-6)


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
    assert rows[0] < rows[-1]  # the drawn line falls
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
        viewer.show_contacts = False
        viewer.log_contacts(contacts, state)
        assert not [n for n in (*viewer.scene.instances, *viewer.scene.lines) if "contact" in n]


def boxes(places, half=0.5):
    """Boxes at places on bodies, over the ground."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    for place in places:
        body = builder.add_body(xform=(place, (0.0, 0.0, 0.0, 1.0)), mass=1.0)
        builder.add_shape_box(body, hx=half, hy=half, hz=half)
    return builder.finalize()


def test_a_pointer_picks_the_front_body_anywhere_on_it():
    model = boxes([(0.0, 0.0, 1.0), (0.0, 3.0, 1.0), (2.5, 0.0, 1.0)])
    state = model.state()
    viewer = SceneViewer()
    viewer.set_model(model)
    viewer.look_at((0.0, -8.0, 1.0), (0.0, 0.0, 1.0))
    viewer.log_state(state)
    drag, size = Drag(viewer), (800, 600)
    corners = np.float32([[0.45, -0.5, 1.45], [-0.45, -0.5, 0.55], [2.9, -0.5, 1.4]])
    pixels = viewer.camera.project(corners, *size)
    assert [drag.pick(x, y, size)[:2] for x, y in pixels] == [("body", 0), ("body", 0), ("body", 2)]
    x, y = viewer.camera.project(np.float32([[0.0, 0.0, 2.4]]), *size)[0]
    assert drag.pick(x, y, size) is None  # the pixel is above both boxes
    assert viewer.body_at((0.0, -8.0, 1.0), (0.0, 1.0, 0.0)) == 0
    assert viewer.body_at((0.0, 2.0, 1.0), (0.0, 1.0, 0.0)) == 1
    assert viewer.body_at((0.0, -8.0, 1.0), (0.0, -1.0, 0.0)) is None

    # A dragged body follows the pointer: no pull before the pointer moves, then a pull towards it.
    x, y = pixels[0]
    drag.start(x, y, size)
    drag.apply(state)
    assert np.abs(state.body_f.numpy()).max() < 1e-3
    drag.move(x + 50.0, y, size)
    drag.apply(state)
    force, mass = state.body_f.numpy(), float(model.body_mass.numpy()[0])
    assert force[0, 0] > 1.0 and np.abs(force[0, 1:3]).max() < 0.01 * force[0, 0]
    assert not force[1:].any()
    meters = 50.0 * 8.0 * 2.0 * np.tan(np.radians(20.0)) / 600.0
    assert force[0, 0] == pytest.approx(mass * 36.0 * meters, rel=0.01)
    drag.stop()
    state.clear_forces()
    drag.apply(state)
    assert not state.body_f.numpy().any()


def test_shapes_are_shown_in_other_colors(tmp_path):
    model = boxes([(0.0, 0.0, 1.0), (2.0, 0.0, 1.0)])
    viewer = SceneViewer()
    with pytest.raises(ValueError, match="set_model"):
        viewer.set_shape_colors([0], [(1, 0, 0)])
    viewer.set_model(model)
    own = viewer.scene.instances["model/box"].colors.values.copy()
    viewer.set_shape_colors([0, 2], [(1, 1, 1, 0.9), (1, 0, 0, 0)])
    np.testing.assert_allclose(
        viewer.scene.instances["model/plane"].colors.values, [(1, 1, 1, 0.9)], rtol=1e-6
    )
    np.testing.assert_array_equal(
        viewer.scene.instances["model/box"].colors.values, [own[0], (1, 0, 0, 0)]
    )
    viewer.set_shape_colors([1], (0, 1, 0))
    np.testing.assert_array_equal(
        viewer.scene.instances["model/box"].colors.values, [(0, 1, 0, 0), own[1]]
    )
    with pytest.raises(ValueError, match="3 shapes"):
        viewer.set_shape_colors([3], (0, 1, 0))
    with pytest.raises(ValueError, match="colors"):
        viewer.set_shape_colors([0, 1], [(0, 1)])

    path = tmp_path / "run.nprec"
    with novaphy.ViewerFile(path) as file:
        file.set_model(model)
        for k in range(3):
            file.begin_frame(k)
            file.set_shape_colors([1], (0, 0, 1) if k else (0, 1, 0))
            file.log_state(model.state())
            file.end_frame()
    file.load_recording(path)
    again = SceneViewer()
    file.show_start(again)
    file.show_frame(again, 2, from_start=True)
    np.testing.assert_array_equal(again.scene.instances["model/box"].colors.values[0], (0, 0, 1, 0))


def test_a_viewer_without_a_user_leaves_a_slider_where_it_is():
    viewer = novaphy.ViewerNull(1)
    assert viewer.add_slider("mass", 0.0, 2.0, 0.5)() == 0.5
    with pytest.raises(ValueError, match="add_slider, value: expected 0.0 <= 3.0 <= 2.0"):
        viewer.add_slider("mass", 0.0, 2.0, 3.0)


def test_showing_a_state_allocates_nothing_for_a_body():
    peaks = []
    for count in (100, 10_000):
        model = boxes([(float(k), 0.0, 1.0) for k in range(count)], 0.1)
        state = model.state()
        viewer = SceneViewer()
        viewer.set_model(model)
        viewer.log_state(state)
        tracemalloc.start()
        viewer.log_state(state)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + 1000 < 10_000, peaks


class Screen(SceneViewer):
    """A window that is closed after some frames, and where somebody presses reset at one."""

    def __init__(self, frames, reset_at=None):
        """Close after `frames`."""
        super().__init__()
        self.left, self.reset_at = frames, reset_at
        self.reset_requested = False
        self.times = []

    def log_state_arrays(self, arrays):
        """Keep the time, and where the body is."""
        super().log_state_arrays(arrays)
        if self._shows:
            self.times.append((round(self.time, 3), float(arrays["body_q"][0, 0])))

    _shows = False

    def begin_frame(self, t):
        """A frame begins."""
        super().begin_frame(t)
        self._shows = True

    def end_frame(self):
        """Close in time."""
        self._shows = False
        if len(self.times) == self.reset_at:
            self.reset_requested, self.reset_at = True, None
        self._running = len(self.times) < self.left


def test_a_window_replays_the_simulation_and_files_hold_it_once():
    model = boxes([(0.0, 0.0, 1.0)])
    state = model.state()
    args = argparse.Namespace(refresh=None, record=None, live=True)
    screen, file = Screen(11, reset_at=5), Screen(100)
    with viewers.Stage(args, model, fps=1000.0, viewers=[screen, file]) as stage:
        stage._screen, stage._waits = screen, True
        for frames in stage.runs(3):
            for frame in frames:
                poses = state.body_q.numpy()
                poses[0, 0] = frame
                state.body_q.assign(poses)
                stage.show(frame / 10, state)
    once = [(0.1, 1.0), (0.2, 2.0), (0.3, 3.0)]
    assert file.times == once
    # The replay restarts after its second frame, then runs until the window is closed.
    assert screen.times == once + once[:2] + once + once


@pytest.mark.parametrize("paused", [False, True])
def test_a_reset_begins_a_running_simulation_again(paused):
    model = boxes([(0.0, 0.0, 1.0)])
    args = argparse.Namespace(refresh=None, record=None, live=True)
    # Shown are a start and two frames, then a start and four frames, then the replay of these.
    screen = Screen(12, reset_at=3)
    waited = []
    if paused:  # when the reset comes, and for a while after it

        def end_frame():
            Screen.end_frame(screen)
            waited.extend([len(screen.times)] * screen._paused)
            screen._paused = len(screen.times) == 3 or (screen._paused and len(waited) < 5)

        screen.end_frame = end_frame
    with viewers.Stage(args, model, fps=1000.0, viewers=[screen]) as stage:
        stage._screen, stage._waits = screen, True
        for frames in stage.runs(4):
            state, after = model.state(), model.state()
            solver = novaphy.solvers.SolverSemiImplicit(model)
            stage.show(0.0, state)
            for frame in frames:
                poses = state.body_q.numpy()
                poses[0, 0] += frame  # a change that a reset undoes
                state.body_q.assign(poses)
                state.clear_forces()
                solver.step(state, after, None, None, 0.1)
                state, after = after, state
                stage.show(frame / 10, state)
    whole = [(0.0, 0.0), (0.1, 1.0), (0.2, 3.0), (0.3, 6.0), (0.4, 10.0)]
    assert screen.times == whole[:3] + whole + whole[:4]
    assert waited == [4] * 5 * paused  # at the start, which is shown


def test_a_window_replays_the_last_rollout():
    model = boxes([(0.0, 0.0, 1.0)])
    state = model.state()
    args = argparse.Namespace(refresh=None, record=None, live=True)
    screen, file = Screen(10), Screen(100)

    def frames(first):
        for k in range(2):
            poses = state.body_q.numpy()
            poses[0, 0] = first + k
            state.body_q.assign(poses)
            yield k / 10, state

    with viewers.Stage(args, model, fps=1000.0, viewers=[screen, file]) as stage:
        stage._screen, stage._waits = screen, True
        for k in range(2):
            stage.iteration(k, 1.0, lambda k=k: frames(10.0 * k), {"path": np.zeros((3, 3))})
    rollouts = [(0.0, 0.0), (0.1, 1.0), (0.0, 10.0), (0.1, 11.0)]
    assert file.times == rollouts
    assert screen.times == rollouts + 3 * rollouts[2:]


@pytest.mark.parametrize("kind", ["ViewerGL", "ViewerViser"])
def test_no_call_of_a_viewer_silently_does_nothing(kind):
    viewer = getattr(viewers, kind)
    asks_only = {"is_running", "is_paused", "get_frame"}  # the last raises where it is not drawn
    calls = {n: f for n, f in vars(viewers.Viewer).items() if callable(f) and n[0] != "_"}
    assert len(calls) > 25
    assert {n for n, f in calls.items() if getattr(viewer, n) is f} <= asks_only
