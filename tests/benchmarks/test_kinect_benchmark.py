"""The Kinect benchmark: raw images, and the memory of a process."""

import os

import numpy as np

from benchmarks.kinect import read_raw_images
from drivers.freenect.bindings import DEPTH_11_BIT_PACKED
from tests.resource_leaks import proportional_memory_kb
from tests.simulators.fixtures import pattern_frame
from tests.simulators.usb_frames import UsbFrames, to_bayer


def test_raw_images_are_those_that_the_kinect_sends(kinect_frames: UsbFrames) -> None:
    images = read_raw_images(kinect_frames)
    assert len(images) == kinect_frames.count
    for seq, (color, packed) in enumerate(images):
        assert np.array_equal(color, to_bayer(pattern_frame(seq)[0]))
        assert packed.shape == DEPTH_11_BIT_PACKED.shape


def test_memory_consists_of_private_file_and_shared_pages() -> None:
    every, *parts = proportional_memory_kb(os.getpid())
    assert abs(every - sum(parts)) <= len(parts)  # rounded
    assert parts[0] > 1000
