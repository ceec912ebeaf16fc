"""A fleet on one router with TLS: each robot is restricted to its own prefix."""

from collections.abc import Iterator

import pytest
import zenoh

from tests.vo_service.security.tls_network import TlsNetwork, query_replies, receives_kept_message
from tests.waiting import wait_until
from vo_service.outputs.zenoh.session import declare_latched_publisher

pytestmark = pytest.mark.zenoh


@pytest.fixture
def router(network: TlsNetwork) -> Iterator[zenoh.Session]:
    with network.open_session("fleet-router.json5", network.server_identity) as session:
        yield session


@pytest.fixture
def robot1(network: TlsNetwork, router: zenoh.Session) -> Iterator[zenoh.Session]:
    """A robot that replies to a command and a query, with a liveliness token."""
    with network.open_session("fleet-robot.json5", "ours/robot1") as session:
        for key in ("robot1/command/reset", "robot1/latest"):
            session.declare_queryable(key, lambda query: query.reply(query.key_expr, b"done"))
        with session.liveliness().declare_token("robot1/alive"):
            yield session


def reader(network: TlsNetwork) -> zenoh.Session:
    return network.open_session("reader-tls.json5", "ours/reader")


@pytest.mark.subprocess
def test_one_subscriber_reads_all_robots(network: TlsNetwork, robot1: zenoh.Session) -> None:
    received: set[str] = set()
    with (
        network.open_session("fleet-robot.json5", "ours/robot2") as robot2,
        reader(network) as session,
        session.declare_subscriber("*/odom", lambda sample: received.add(str(sample.key_expr))),
    ):

        def are_both_received() -> bool:
            robot1.put("robot1/odom", b"pose")
            robot2.put("robot2/odom", b"pose")
            return received == {"robot1/odom", "robot2/odom"}

        wait_until(are_both_received)


def test_a_late_reader_gets_the_map_of_a_robot(network: TlsNetwork, robot1: zenoh.Session) -> None:
    kept = declare_latched_publisher(robot1, "robot1/map")
    kept.put(b"kept")
    with reader(network) as session:
        assert receives_kept_message(session, "*/map")
    kept.undeclare()  # type: ignore[no-untyped-call]


def test_a_robot_cannot_publish_below_the_prefix_of_another(
    network: TlsNetwork, robot1: zenoh.Session
) -> None:
    received: list[tuple[str, bytes]] = []
    with (
        reader(network) as session,
        session.declare_subscriber(
            "*/odom",
            lambda sample: received.append((str(sample.key_expr), sample.payload.to_bytes())),
        ),
    ):

        def is_received() -> bool:
            robot1.put("robot2/odom", b"forged")
            robot1.put("*/odom", b"forged")
            robot1.put("robot1/odom", b"own")
            return len(received) > 5

        wait_until(is_received)
    assert set(received) == {("robot1/odom", b"own")}


def test_a_robot_cannot_reply_for_another(network: TlsNetwork, robot1: zenoh.Session) -> None:
    with (
        network.open_session("fleet-robot.json5", "ours/robot2") as robot2,
        robot2.declare_queryable(
            "robot1/latest", lambda query: query.reply(query.key_expr, b"forged")
        ),
        reader(network) as session,
    ):
        assert query_replies(session, "robot1/latest") == [b"done"]


def test_operators_command_a_robot_and_readers_do_not(
    network: TlsNetwork, robot1: zenoh.Session
) -> None:
    with reader(network) as session:
        wait_until(lambda: query_replies(session, "robot1/latest") == [b"done"])
        assert query_replies(session, "robot1/command/reset") == []
        session.put("robot1/odom", b"forged")
    with network.open_session("operator-tls.json5", "ours/operator") as operator:
        wait_until(lambda: query_replies(operator, "robot1/command/reset") == [b"done"])


def test_a_robot_cannot_command_another(network: TlsNetwork, robot1: zenoh.Session) -> None:
    with network.open_session("fleet-robot.json5", "ours/robot2") as robot2:
        wait_until(lambda: bool(robot2.info.links()))
        assert query_replies(robot2, "robot1/command/reset") == []
        assert query_replies(robot2, "robot1/latest") == []


def test_nobody_in_the_fleet_sends_the_odometry_of_a_robots_wheels(
    network: TlsNetwork, robot1: zenoh.Session
) -> None:
    received: list[bytes] = []
    robot1.declare_subscriber(
        "robot1/wheel_odom", lambda sample: received.append(sample.payload.to_bytes())
    )
    with network.open_session("operator-tls.json5", "ours/operator") as operator:
        for _ in range(20):
            operator.put("robot1/wheel_odom", b"forged")
            wait_until(lambda: query_replies(operator, "robot1/command/reset") == [b"done"])
    assert received == []


def test_readers_see_the_liveliness_of_robots(network: TlsNetwork, robot1: zenoh.Session) -> None:
    def alive() -> list[str]:
        replies = session.liveliness().get("*/alive", timeout=60)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok]

    with reader(network) as session:
        wait_until(lambda: alive() == ["robot1/alive"])


def test_a_robot_of_another_authority_is_refused(
    network: TlsNetwork, router: zenoh.Session
) -> None:
    strange = network.folder / "strange/operator"
    (strange / "ca.pem").write_bytes((network.folder / "ours/robot1/ca.pem").read_bytes())
    with network.open_session("fleet-robot.json5", "strange/operator") as unauthorized:
        assert query_replies(unauthorized, "robot1/latest") == []
        assert list(router.info.links()) == []
