"""From one place to the next."""

import numpy as np

from tests.vo_service.mapping.live.views import view
from vo_service.mapping.loops.hop import Hop, Hops, NoHops
from vo_service.outputs.output import TrackingState


def hops_at(*xs_m: float, hops: Hops | None = None, epoch: int = 0) -> list[Hop | None]:
    """What is said of frames along the wall, 30 a second."""
    hops = hops or Hops()
    return [hops.next(view(seq, x_m, epoch=epoch)) for seq, x_m in enumerate(xs_m)]


def test_a_place_is_thirty_centimetres_from_the_last() -> None:
    found = hops_at(0.0, 0.1, 0.2, 0.29, 0.31, 0.4)
    assert [hop is not None for hop in found] == [True, False, False, False, True, False]


def test_a_hop_tells_its_length_its_velocity_and_how_sure_it_is() -> None:
    first, *_, last = hops_at(0.0, 0.1, 0.2, 0.31)
    assert first is not None
    assert last is not None
    assert first.length_m == 0.0
    assert np.isclose(last.length_m, 0.31)
    assert np.allclose(last.velocity, [0.11 * 30, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-6)
    assert np.trace(last.covariance) > np.trace(first.covariance)


def test_a_new_epoch_counts_from_its_beginning() -> None:
    hops = Hops()
    hops_at(0.0, 0.1, hops=hops)
    (first,) = hops_at(5.0, hops=hops, epoch=1)
    assert first is not None
    assert first.length_m == 0.0
    assert not first.velocity.any()


def test_what_is_not_tracked_or_not_remembered_is_no_place() -> None:
    assert Hops().next(view(0, state=TrackingState.DEGRADED)) is None
    assert Hops().next(view(0, state=TrackingState.LOST)) is None
    NoHops().forget()
    assert hops_at(0.0)[0] is not None


def test_what_forgets_takes_the_next_frame() -> None:
    hops = Hops()
    assert hops_at(0.0, 0.0, hops=hops)[1] is None
    hops.forget()
    assert hops_at(0.0, hops=hops)[0] is not None
