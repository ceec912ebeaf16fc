from collections.abc import Sequence

from hypothesis import given
from hypothesis import strategies as st

from drivers.time_sync import MAX_PAIR_SKEW_S, NearestFramePairing, StampedPair

PERIOD_S = 1 / 30
Images = list[StampedPair[int, int]]


def run(
    colors_s: Sequence[float], depths_s: Sequence[float], late_s: float = 0.0, period_s: float = 0.0
) -> tuple[Images, NearestFramePairing[int, int]]:
    """Pairs, when depth arrives `late_s` behind color of the same stamp."""
    pairing: NearestFramePairing[int, int] = NearestFramePairing(min_period_s=period_s)
    events = [(s, pairing.add_color, s, k) for k, s in enumerate(colors_s)]
    events += [(s + late_s, pairing.add_depth, s, k) for k, s in enumerate(depths_s)]
    pairs: Images = []
    for _, add, stamp_s, k in sorted(events, key=lambda event: event[0]):
        pairs += add(stamp_s, k)
    return pairs + pairing.finish(), pairing


def irregular() -> st.SearchStrategy[list[float]]:
    """Stamps that rise by anything: as from a recording with holes."""
    return st.lists(st.integers(1, 90), max_size=40).map(
        lambda steps: [sum(steps[: k + 1]) / 1000 for k in range(len(steps))]
    )


@given(irregular(), irregular(), st.floats(-0.03, 0.03))
def test_each_depth_image_gets_the_nearest_color_image(
    colors_s: list[float], depths_s: list[float], late_s: float
) -> None:
    for pair in run(colors_s, depths_s, late_s)[0]:
        assert abs(pair.skew_s) <= MAX_PAIR_SKEW_S
        assert all(abs(pair.skew_s) <= abs(pair.depth_s - s) for s in colors_s)


@given(irregular(), irregular())
def test_every_image_is_used_once_in_order_or_counted(
    colors_s: list[float], depths_s: list[float]
) -> None:
    pairs, pairing = run(colors_s, depths_s)
    for used in ([p.color for p in pairs], [p.depth for p in pairs]):
        assert used == sorted(set(used))
    paired_early = [p for p in pairs if p.depth_s < colors_s[0]]
    later = [s for s in depths_s if colors_s and s >= colors_s[0]]
    assert len(pairs) - len(paired_early) + pairing.unpaired == len(later)


@given(st.floats(-0.0166, 0.0166), st.floats(-0.02, 0.02), st.sets(st.integers(0, 59), max_size=30))
def test_two_streams_of_30_hz_pair_up_at_any_phase(
    phase_s: float, late_s: float, torn: set[int]
) -> None:
    colors_s = [k * PERIOD_S for k in range(60)]
    depths_s = [k * PERIOD_S + phase_s for k in range(60) if k not in torn]
    pairs, _ = run(colors_s, depths_s, late_s, period_s=0.03)
    assert len(pairs) == len(depths_s)
    assert all(abs(pair.skew_s - phase_s) < 1e-9 for pair in pairs)


def test_a_nearer_next_color_image_is_awaited() -> None:
    pairing: NearestFramePairing[str, str] = NearestFramePairing()
    assert pairing.add_color(0.0, "before") == []
    assert pairing.add_depth(0.021, "depth") == []
    (pair,) = pairing.add_color(0.0333, "after")
    assert (pair.color, round(pair.skew_s, 4)) == ("after", -0.0123)


def test_an_optimal_pair_is_available_at_once() -> None:
    pairing: NearestFramePairing[str, str] = NearestFramePairing()
    pairing.add_color(0.0, "color")
    (pair,) = pairing.add_depth(0.012, "depth")
    assert (pair.color, pair.depth, pair.skew_s) == ("color", "depth", 0.012)


def test_images_too_far_apart_are_not_paired() -> None:
    pairs, pairing = run([0.0, 0.1], [0.021, 0.079])
    assert (pairs, pairing.unpaired) == ([], 2)


def test_a_silent_stream_delays_only_a_few_images() -> None:
    pairing: NearestFramePairing[int, int] = NearestFramePairing()
    pairing.add_color(-1.0, 0)
    for k in range(100):
        pairing.add_depth(k * PERIOD_S, k)
    assert pairing.unpaired == 96


def test_depth_before_the_first_color_image_is_skipped() -> None:
    pairs, pairing = run([0.1, 0.1333], [0.0, 0.0333, 0.0667, 0.1, 0.1333])
    assert (len(pairs), pairing.unpaired) == (2, 0)
