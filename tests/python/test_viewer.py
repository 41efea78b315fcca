"""ViewerFile records and plays back; ViewerNull runs for a while; both take every call."""

from __future__ import annotations

import itertools
import json
import stat
import sys

import numpy as np
import pytest
from scenes import DT, Ball

import novaphy
from novaphy import ViewerFile, ViewerNull, create_viewer
from novaphy.viewer import Viewer, _file, _recording


@pytest.fixture(scope="module")
def ball():
    """A short rollout."""
    ball = Ball(steps=20)
    ball.forward()
    return ball


def record(ball, path, **options):
    """Record all states of a rollout."""
    viewer = ViewerFile(path, **options)
    viewer.set_model(ball.model)
    for k, state in enumerate(ball.states):
        viewer.begin_frame(k * DT)
        viewer.log_state(state)
        viewer.end_frame()
    return viewer


def test_a_recording_comes_back_to_the_bit(ball, tmp_path):
    path = tmp_path / "ball.npz"
    record(ball, path).close()
    viewer = ViewerFile(path)
    viewer.load_recording()
    assert viewer.frame_count == 21
    np.testing.assert_allclose(viewer.times, np.arange(21) * DT)
    state = ball.model.state()
    for k in (0, 7, 20, -1):
        assert viewer.playback(state, k) == viewer.times[k]
        novaphy.testing.assert_same_bits(state.particle_q, ball.states[k].particle_q)
        novaphy.testing.assert_same_bits(state.particle_qd, ball.states[k].particle_qd)
    for bad in (21, -22):
        with pytest.raises(IndexError, match="frame"):
            viewer.playback(state, bad)


def test_the_file_is_an_archive_with_a_json_header(ball, tmp_path):
    path = record(ball, tmp_path / "ball.npz", auto_save=False).save_recording()
    with np.load(path, allow_pickle=False) as archive:
        header = json.loads(archive["header"].tobytes())
        assert archive["state/particle_q"].shape == (21, 1, 3)
        assert archive["model/shape_type"].tolist() == [7, 1]
    assert header["format"] == "novaphy-recording" and header["version"] == 1
    assert header["frames"] == 21 and header["state"] == ["particle_q", "particle_qd"]
    assert header["novaphy"] == novaphy.version() and header["up_axis"] == 2


def test_saving_happens_at_intervals_and_at_the_end(ball, tmp_path):
    path = tmp_path / "ball.npz"
    viewer = record(ball, path, save_interval=8)
    other = ViewerFile(path)
    other.load_recording()
    assert other.frame_count == 16
    viewer.close()
    other.load_recording()
    assert other.frame_count == 21 and not viewer.is_running()
    never = tmp_path / "never.npz"
    record(ball, never, auto_save=False).close()
    assert not never.exists()
    assert [p.name for p in tmp_path.iterdir()] == ["ball.npz"]
    assert stat.S_IMODE(path.stat().st_mode) & 0o400


def test_an_interrupt_at_any_line_leaves_a_whole_recording(ball, tmp_path):
    path = tmp_path / "ball.nprec"
    files = {_file.__file__, _recording.__file__}
    left = 0

    def trace(frame, event, arg):
        nonlocal left
        if frame.f_code.co_filename not in files:
            return None
        if event == "line":
            left -= 1
            if left == 0:
                raise KeyboardInterrupt
        return trace

    counts, interrupts = set(), 0
    before = sys.gettrace()
    for k in itertools.count(1):
        viewer = ViewerFile(path, save_interval=2)
        viewer.set_model(ball.model)
        left = k
        sys.settrace(trace)
        try:
            for step in range(5):
                viewer.time = float(step)
                viewer.record(ball.states[step])
        except KeyboardInterrupt:
            interrupts += 1
        finally:
            sys.settrace(before)
        viewer.close()
        if viewer.frame_count:
            other = ViewerFile(path, auto_save=False)
            other.load_recording()
            assert other.times.tolist() == list(range(other.frame_count)), k
            assert other.frame_count >= viewer.frame_count
            counts.add(other.frame_count)
        path.unlink(missing_ok=True)
        if left > 0:
            break
    assert interrupts > 100 and counts == {1, 2, 3, 4, 5}


def test_a_recording_that_goes_on_is_never_lost(ball, tmp_path, monkeypatch):
    path = tmp_path / "ball.nprec"
    record(ball, path).close()
    viewer = ViewerFile(path, save_interval=1)
    viewer.load_recording()

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(_recording, "write_start", interrupted)
        with pytest.raises(KeyboardInterrupt):
            viewer.record(ball.states[0])
    other = ViewerFile(path, auto_save=False)
    other.load_recording()
    assert other.frame_count == 21
    viewer.close()
    other.load_recording()
    assert other.frame_count == 22


def test_what_stands_when_frames_are_dropped_is_drawn(ball, tmp_path):
    path = tmp_path / "ball.nprec"
    whole = ViewerFile(tmp_path / "whole.nprec", auto_save=False)
    for viewer in (whole, ViewerFile(path, max_history_size=2, save_interval=1)):
        for k in range(5):
            viewer.begin_frame(float(k))
            viewer.log_points("still", [[1.0, 2.0, 3.0]])
            viewer.log_points("moves", [[float(k), 0.0, 0.0]])
            viewer.log_scalar("loss", float(k))
            viewer.log_state(ball.states[k])
            viewer.end_frame()
    whole.save_recording()
    for file in (path, tmp_path / "whole.nprec"):
        loaded = ViewerFile(tmp_path / "x.nprec", auto_save=False, max_history_size=2)
        loaded.load_recording(file)
        shown = ViewerFile(tmp_path / "y.nprec", auto_save=False)
        loaded.show_frame(shown, 1, from_start=True)
        calls = [(call, options["name"]) for call, options in shown._frames[0].calls]
        expected = [("log_points", "moves"), ("log_points", "still")] + 2 * [("log_scalar", "loss")]
        assert sorted(calls) == expected
        points = [o["points"] for call, o in shown._frames[0].calls if o["name"] == "moves"]
        assert points[0].tolist() == [[4.0, 0.0, 0.0]]


def test_a_model_that_comes_late_is_in_the_recording(ball, tmp_path):
    path = tmp_path / "ball.nprec"
    viewer = ViewerFile(path, save_interval=1)
    viewer.record(ball.states[0])
    viewer.set_model(ball.model)
    with pytest.raises(ValueError, match="numbers or text"):
        viewer.log_array("name", np.array([None], object))
    viewer.close()
    viewer.load_recording()
    assert viewer.frame_count == 1 and "particle_radius" in viewer._model_arrays


def test_only_the_last_frames_are_kept_when_asked(ball, tmp_path):
    viewer = record(ball, tmp_path / "ball.npz", max_history_size=5)
    assert viewer.frame_count == 5
    state = ball.model.state()
    viewer.playback(state, 0)
    novaphy.testing.assert_same_bits(state.particle_q, ball.states[16].particle_q)


def test_a_recorded_state_is_a_copy(tmp_path):
    state = Ball(steps=0).model.state()
    viewer = ViewerFile(tmp_path / "x.npz", auto_save=False)
    viewer.record(state)
    state.particle_q.fill_(9.0)
    viewer.playback(state, 0)
    np.testing.assert_array_equal(state.particle_q[0], [0, -0.5, 1])


def test_states_of_other_sizes_are_refused(ball, tmp_path):
    viewer = record(ball, tmp_path / "ball.npz", auto_save=False)
    other = Ball(balls=2, steps=0).model.state()
    with pytest.raises(ValueError, match="sizes"):
        viewer.record(other)
    with pytest.raises(ValueError, match="sizes"):
        viewer.playback(other, 0)
    assert viewer.frame_count == 21


def test_what_is_no_recording_is_refused_and_nothing_is_lost(ball, tmp_path):
    viewer = record(ball, tmp_path / "ball.npz", auto_save=False)
    files = {
        "text.npz": b"not an archive",
        "empty.npz": b"",
    }
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    np.savez(tmp_path / "plain.npz", a=np.zeros(3))
    np.savez(tmp_path / "pickle.npz", header=np.array([{}], dtype=object))
    header = {"format": "novaphy-recording", "version": 99, "frames": 0, "state": []}
    coded = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez(tmp_path / "new.npz", header=coded)
    header = {**header, "version": 1, "frames": 3, "state": ["particle_q"]}
    coded = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez(tmp_path / "short.npz", header=coded, time=np.zeros(3))
    viewer.save_recording(tmp_path / "whole.npz")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "whole.npz").read_bytes()[:500])
    for name in (*files, "plain.npz", "pickle.npz", "new.npz", "short.npz", "cut.npz"):
        with pytest.raises(ValueError, match="load_recording"):
            viewer.load_recording(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        viewer.load_recording(tmp_path / "none.npz")
    assert viewer.frame_count == 21


def test_a_path_that_cannot_be_written_is_reported(ball, tmp_path):
    with pytest.raises(ValueError, match="folder"):
        ViewerFile(tmp_path / "nowhere" / "ball.npz")
    for options in ({"save_interval": 0}, {"max_history_size": 0}):
        with pytest.raises(ValueError, match=next(iter(options))):
            ViewerFile(tmp_path / "ball.npz", **options)
    viewer = record(ball, tmp_path / "ball.npz", auto_save=False)
    for bad in (tmp_path, tmp_path / "nowhere" / "x.npz", "/proc/x.npz"):
        with pytest.raises((ValueError, OSError)):
            viewer.save_recording(bad)
    assert not list(tmp_path.iterdir()) and viewer.frame_count == 21


def test_an_error_while_writing_leaves_the_old_file(tmp_path):
    path = tmp_path / "x.npz"
    novaphy.io.save_npz(path, a=np.arange(3))
    before = path.read_bytes()

    class Bad:
        """Something that no array can be made of."""

        def __array__(self, dtype=None, copy=None):
            raise RuntimeError("bad")

    with pytest.raises(RuntimeError):
        novaphy.io.save_npz(path, a=Bad())
    assert path.read_bytes() == before and len(list(tmp_path.iterdir())) == 1
    novaphy.io.save_npz(path, b=novaphy.DeviceArray([1.0]), c=[1, 2])
    with np.load(path) as archive:
        assert archive["b"].tolist() == [1] and archive["c"].tolist() == [1, 2]


def test_viewers_take_every_call(ball, tmp_path):
    points = ball.states[0].particle_q
    for viewer in (ViewerNull(2), ViewerFile(tmp_path / "all.npz", auto_save=False)):
        with viewer:
            viewer.set_model(ball.model)
            viewer.set_camera((1, 2, 3), pitch=0.0, yaw=90.0)
            viewer.follow(0)
            viewer.set_world_offsets((1, 0, 0))
            viewer.begin_frame(0.5)
            viewer.log_state(ball.states[0])
            viewer.log_contacts(ball.contacts, ball.states[0])
            viewer.log_mesh("m", points, [[0, 0, 0]], color=(1, 0, 0))
            viewer.log_instances("i", "m", np.zeros((1, 7), np.float32))
            viewer.log_shapes("s", novaphy.GeoType.BOX, (1, 1, 1), np.zeros((1, 7), np.float32))
            viewer.log_lines("l", points, points, None)
            viewer.log_arrows("a", points, points, None)
            viewer.log_points("p", points, radii=0.1)
            viewer.log_array("x", points)
            viewer.log_scalar("y", 1.0)
            viewer.log_image("z", np.zeros((2, 2, 3), np.uint8))
            viewer.apply_forces(ball.states[0])
            assert viewer.should_step() and not viewer.is_paused()
            assert not viewer.is_key_down("space") and viewer.time == 0.5
            with pytest.raises(NotImplementedError, match="picture"):
                viewer.get_frame()
            assert viewer.is_running()
            viewer.end_frame()
        assert not viewer.is_running() and isinstance(viewer, Viewer)


def test_the_null_viewer_counts_and_measures():
    viewer = ViewerNull(num_frames=3, benchmark=True)
    frames = 0
    while viewer.is_running():
        viewer.begin_frame(frames * 0.1)
        viewer.end_frame()
        frames += 1
    assert frames == viewer.frame_count == 3
    assert viewer.benchmark_result()["frames"] == 2 and viewer.benchmark_result()["fps"] > 0
    assert ViewerNull().benchmark_result() is None
    with pytest.raises(ValueError, match="num_frames"):
        ViewerNull(-1)


def test_viewers_are_made_by_name(tmp_path):
    assert isinstance(create_viewer("null", num_frames=5), ViewerNull)
    assert isinstance(create_viewer("file", output_path=tmp_path / "a.npz"), ViewerFile)
    for kind in ("rerun", "canvas"):
        with pytest.raises(ValueError, match="kind"):
            create_viewer(kind)


def draw_and_record(ball, path, frames=21, **options):
    """Record states and drawings; the viewer is left open."""
    viewer = ViewerFile(path, **options)
    viewer.set_model(ball.model)
    viewer.look_at((3.0, 0.0, 1.0), (0.0, 0.0, 0.5))
    for k, state in enumerate(ball.states[:frames]):
        viewer.begin_frame(k * DT)
        viewer.log_state(state)
        viewer.log_points("still", [[0.0, 0.0, 0.0]], 0.1)
        viewer.log_lines("way", [[0, 0, 0]], [[0, 0, 1 + k]], (1.0, 0.0, 0.0), width=0.02)
        viewer.log_scalar("height", float(k))
        viewer.end_frame()
    return viewer


class Calls(Viewer):
    """Keeps the calls that a recording makes."""

    def __init__(self):
        """Start without any."""
        super().__init__()
        self.calls = []

    def log_points(self, name, points, radii=None, colors=None, hidden=False):
        """Keep it."""
        self.calls.append((self.time, name))

    def log_lines(self, name, starts, ends, colors, width=0.01, hidden=False):
        """Keep it."""
        self.calls.append((self.time, name, float(ends[0][2]), list(colors), width))

    def log_state_arrays(self, arrays):
        """Keep it."""
        self.calls.append((self.time, arrays["particle_q"].tobytes()))


def test_drawings_are_recorded_and_shown_again(ball, tmp_path):
    path = tmp_path / "run.nprec"
    draw_and_record(ball, path, save_interval=8).close()
    viewer = ViewerFile(tmp_path / "other.nprec", auto_save=False)
    viewer.load_recording(path)
    shown = Calls()
    viewer.show(shown)
    assert [c[1:] for c in shown.calls if c[1] == "way"] == [
        ("way", 1.0 + k, [1.0, 0.0, 0.0], 0.02) for k in range(21)
    ]
    assert [c for c in shown.calls if c[1] == "still"] == [(0.0, "still")]  # the log never changed
    states = [c[1] for c in shown.calls if isinstance(c[1], bytes)]
    assert states == [state.particle_q.numpy().tobytes() for state in ball.states]
    shown.calls.clear()
    viewer.show_frame(shown, 7, from_start=True)
    assert [c[1] for c in shown.calls[:2]] == ["still", "way"] and shown.calls[1][2] == 8.0
    viewer.save_recording(tmp_path / "again.nprec")
    assert (tmp_path / "again.nprec").stat().st_size < 1.1 * path.stat().st_size
    state = ball.model.state()
    assert viewer.playback(state, 20) == 20 * DT
    novaphy.testing.assert_same_bits(state.particle_q, ball.states[20].particle_q)


def test_a_killed_program_loses_the_last_chunk_at_most(ball, tmp_path):
    path = tmp_path / "run.nprec"
    viewer = draw_and_record(ball, path, save_interval=8)  # neither closed nor saved
    other = ViewerFile(tmp_path / "other.nprec", auto_save=False)
    other.load_recording(path)
    assert other.frame_count == 16
    whole = path.read_bytes()
    for cut in (len(whole) - 1, len(whole) - 5000):
        path.write_bytes(whole[:cut])
        other.load_recording(path)
        assert other.frame_count == 8
    path.write_bytes(whole[:-100] + bytes([whole[-100] ^ 1]) + whole[-99:])
    other.load_recording(path)
    assert other.frame_count == 8
    path.write_bytes(whole[:30])
    with pytest.raises(ValueError, match="incomplete"):
        other.load_recording(path)
    assert other.frame_count == 8
    viewer.save_recording()
    other.load_recording(path)
    assert other.frame_count == 21


def test_a_recording_shows_itself_in_a_notebook(ball, tmp_path):
    viewer = draw_and_record(ball, tmp_path / "run.nprec", auto_save=False)
    inline = viewer._repr_html_()
    assert inline.startswith("<iframe") and "&quot;way&quot;" in inline
    assert not list(tmp_path.iterdir())
