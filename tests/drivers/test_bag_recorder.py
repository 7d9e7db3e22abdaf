"""Rows in shared memory, and the bag that a process of its own writes from them. Nothing here holds up the loop."""

from __future__ import annotations

import os
import pickle
import resource
import signal
import subprocess
import threading
import time
from multiprocessing import resource_sharer
from multiprocessing.reduction import ForkingPickler

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from coopqp.drivers import BagRecorder
from coopqp.drivers.ring import ObjectRing, RowRing
from coopqp.errors import MissingExtraError, OutputError

JOINTS = ("left/a", "left/b")


def _take(recorder, number, begin=0):
    for i in range(begin, begin + number):
        recorder.take(1.0 + 0.002 * i, np.array([i, np.nan]), np.array([i, -i], float), None, 0.0)


def test_a_ring_gives_all_rows_in_order_and_counts_those_that_were_written_over():
    ring = RowRing(3, 8)
    reader = RowRing(3, 8, handle=os.dup(ring.handle))

    def push(begin, end):
        for i in range(begin, end):
            ring.row()[:] = i
            ring.push()

    try:
        push(0, 5)
        np.testing.assert_array_equal(reader.read()[:, 0], np.arange(5))
        push(5, 12)  # the slot of the row that would come next is never read
        np.testing.assert_array_equal(reader.read()[:, 0], np.arange(5, 12))
        assert reader.lost == 0
        push(12, 32)
        np.testing.assert_array_equal(reader.read()[:, 2], np.arange(25, 32))
        assert reader.lost == 13
        assert len(reader.read()) == 0
        assert not reader.ended
        ring.end()
        assert reader.ended
    finally:
        reader.close()
        ring.close()


def test_a_ring_has_no_name_and_is_gone_with_its_processes():
    ring = RowRing(3, 8)
    assert os.fstat(ring.handle).st_nlink == 0
    ring.close()


def test_a_ring_of_objects_gives_the_newest():
    ring = ObjectRing(size=200, slots=4)
    reader = pickle.loads(ForkingPickler.dumps(ring))  # as a process of multiprocessing gets it
    try:
        assert reader.newest() is None
        ring.tell({"q": [1.0, 2.0]})
        assert reader.newest() == {"q": [1.0, 2.0]}
        for word in ("a", "b", "c" * 1000):  # the last one is too large
            ring.tell(word)
        assert reader.newest() == "b"
        for i in range(10):
            ring.tell(i)
        assert reader.newest() == 9
        assert reader.newest() is None
        ring.end()
        assert reader.ended
    finally:
        reader.close()
        ring.close()
        resource_sharer.stop()
    ring.tell(10)  # left out, and no error
    ring.close()


@pytest.mark.slow
def test_a_reader_beside_a_writer_sees_whole_rows_and_misses_none_without_counting_it():
    ring, number = RowRing(64, 16), 20_000
    reader = RowRing(64, 16, handle=os.dup(ring.handle))

    def write():
        for i in range(number):
            ring.row()[:] = i
            ring.push()
        ring.end()

    thread, seen = threading.Thread(target=write), []
    thread.start()
    while True:
        last = reader.ended
        rows = reader.read()
        assert (rows == rows[:, :1]).all()
        seen += rows[:, 0].tolist()
        if last:
            break
    thread.join()
    assert (np.diff(seen) > 0).all()
    assert len(seen) + reader.lost == number
    reader.close()
    ring.close()


@pytest.mark.slow
def test_every_period_is_in_the_bag(tmp_path):
    recorder, before = BagRecorder(JOINTS, tmp_path / "run"), time.time()
    _take(recorder, 700)
    after = time.time()
    assert recorder.close() == (0, "")
    with AnyReader([tmp_path / "run"]) as bag:
        topic = [
            (at, bag.deserialize(data, c.msgtype)) for c, at, data in bag.messages() if c.topic == "/joint_commands"
        ]
    stamps, sent = 1e-9 * np.array([at for at, _ in topic]), [message for _, message in topic]
    assert before <= stamps[0] <= after  # since the epoch, whatever the loop's clock shows
    np.testing.assert_allclose(np.diff(stamps), 0.002, atol=1e-6)
    assert len(sent) == 700
    assert list(sent[5].name) == list(JOINTS)
    np.testing.assert_array_equal([m.position[1] for m in sent], -np.arange(700.0))
    with pytest.raises(OutputError, match="exists"):
        BagRecorder(JOINTS, tmp_path / "run")


@pytest.mark.slow
def test_a_writer_that_is_killed_holds_nobody_up(tmp_path):
    recorder = BagRecorder(JOINTS, tmp_path / "run")
    _take(recorder, 100)
    recorder.process.send_signal(signal.SIGKILL)
    _take(recorder, 20_000, 100)
    assert recorder.close() == (20_100, "its writer was killed")


@pytest.mark.slow
def test_a_full_disk_is_said_at_the_end(tmp_path, monkeypatch):
    def limited(*given, **more):
        return popen(*given, preexec_fn=limit, **more)

    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    popen = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", limited)
    recorder = BagRecorder(JOINTS, tmp_path / "run")
    _take(recorder, 8000)
    missing, why = recorder.close()
    assert missing == 8000
    assert "large" in why


def test_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rosbags.rosbag2", None)
    with pytest.raises(MissingExtraError, match=r"coopqp\[bags\]"):
        BagRecorder(JOINTS, tmp_path / "run")
