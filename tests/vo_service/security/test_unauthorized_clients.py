"""A robot on the network with TLS and access control: authentication, permissions, load."""

import json
import subprocess
import sys
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest
import zenoh

from tests.vo_service.security.tls_network import (
    HOST,
    TlsNetwork,
    TlsRobot,
    can_connect,
    is_contiguous,
    query_replies,
    receive_pose_numbers,
    receives_kept_message,
)
from tests.waiting import wait_until
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import declare_latched_publisher, open_session

pytestmark = pytest.mark.zenoh

FLOOD = Path(__file__).with_name("command_flood.py")


def test_a_certificate_of_another_authority_is_refused(
    network: TlsNetwork, robot: TlsRobot
) -> None:
    strange, ours = network.folder / "strange/operator", network.folder / "ours/operator"
    (strange / "ca.pem").write_bytes(
        (ours / "ca.pem").read_bytes()
    )  # only the client trusts the robot
    assert not can_connect(network.file("operator-tls.json5", "strange/operator"))
    assert can_connect(network.file("operator-tls.json5", "ours/operator"))


def test_no_certificate_is_refused(network: TlsNetwork, robot: TlsRobot) -> None:
    file = network.file("reader-tls.json5", "ours/reader")
    lines = file.read_text().splitlines()
    file.write_text("\n".join(line for line in lines if "connect_" not in line))
    assert not can_connect(file)


def test_plain_tcp_to_the_encrypted_port_is_refused(network: TlsNetwork, robot: TlsRobot) -> None:
    file = network.file("reader-tls.json5", "ours/reader")
    file.write_text(file.read_text().replace("tls/", "tcp/"))
    assert not can_connect(file)


def test_a_reader_reads_but_cannot_command(network: TlsNetwork, robot: TlsRobot) -> None:
    with network.open_session("reader-tls.json5", "ours/reader") as reader:
        with receive_pose_numbers(reader):
            assert query_replies(reader, "kinect/latest")
            assert query_replies(reader, "kinect/map_odom")
            assert query_replies(reader, "kinect/command/reset") == []
            assert query_replies(reader, "kinect/command/pause") == []
        assert [
            str(reply.ok.key_expr)
            for reply in reader.liveliness().get("*/alive", timeout=60)
            if reply.ok
        ] == ["kinect/alive"]
    assert robot.executed == []


@pytest.mark.parametrize("name", ["map", "tf_static"])
def test_a_reader_gets_what_a_navigating_robot_needs(
    network: TlsNetwork, robot: TlsRobot, name: str
) -> None:
    kept = declare_latched_publisher(robot.session, f"kinect/{name}")
    kept.put(b"kept")
    received: list[zenoh.Sample] = []
    with network.open_session("reader-tls.json5", "ours/reader") as reader:
        assert receives_kept_message(reader, f"kinect/{name}")
        reader.declare_subscriber("kinect/scan", received.append)

        def is_received() -> bool:
            robot.put("kinect/scan", b"scan")
            return bool(received)

        wait_until(is_received)
    kept.undeclare()  # type: ignore[no-untyped-call]


def test_only_a_viewer_sees_images(network: TlsNetwork, robot: TlsRobot) -> None:
    received: list[str] = []
    with ExitStack() as stack:
        for name in ("reader", "operator", "viewer"):
            file = "operator-tls.json5" if name == "operator" else "reader-tls.json5"
            session = stack.enter_context(network.open_session(file, f"ours/{name}"))
            for key in ("color/image", "depth/compressed", "points"):
                session.declare_subscriber(
                    f"kinect/{key}",
                    lambda _, name=name: received.append(name),  # type: ignore[misc]
                )
            stack.enter_context(receive_pose_numbers(session))  # each is connected

        def has_viewer_all() -> bool:
            for key in ("color/image", "depth/compressed", "points"):
                robot.put(f"kinect/{key}", b"image")
            return received.count("viewer") > 30

        wait_until(has_viewer_all)
    assert set(received) == {"viewer"}


def test_an_operator_can_command(network: TlsNetwork, robot: TlsRobot) -> None:
    with network.open_session("operator-tls.json5", "ours/operator") as operator:
        (reply,) = query_replies(operator, "kinect/command/reset")
    assert json.loads(reply)["schema"] == 1
    assert len(robot.executed) == 1


def test_a_certificate_without_a_rule_gets_nothing(network: TlsNetwork, robot: TlsRobot) -> None:
    with (
        network.open_session("reader-tls.json5", "ours/robot1") as outsider,
        network.open_session("reader-tls.json5", "ours/reader") as reader,
    ):
        received: list[object] = []
        with outsider.declare_subscriber("kinect/odom", received.append):
            assert query_replies(outsider, "kinect/latest") == []
            assert query_replies(outsider, "kinect/map_odom") == []
            assert query_replies(outsider, "kinect/status") == []
            with receive_pose_numbers(reader) as others:
                wait_until(lambda: len(others) > 10)
    assert received == []


def test_other_clients_cannot_publish_poses(network: TlsNetwork, robot: TlsRobot) -> None:
    with (
        network.open_session("operator-tls.json5", "ours/operator") as operator,
        network.open_session("reader-tls.json5", "ours/reader") as reader,
        receive_pose_numbers(reader) as received,
    ):
        for count in range(1, 21):
            operator.put("kinect/odom", b"forged")
            wait_until(partial(_has_more_than, received, count))
    assert is_contiguous(received)


@pytest.mark.parametrize("key", ["kinect/wheel_odom", "kinect/cmd_vel"])
def test_only_programs_on_the_robot_drive_it_and_send_the_odometry_of_its_wheels(
    network: TlsNetwork, robot: TlsRobot, key: str
) -> None:
    here = ZenohConfig(listen=(), connect=(f"tcp/{HOST}:{network.local_port}",))
    with (
        open_session(here) as local,
        network.open_session("operator-tls.json5", "ours/operator") as operator,
        receive_pose_numbers(operator),
    ):

        def has_received() -> bool:
            operator.put(key, b"forged")
            local.put(key, b"ours")
            return len(robot.base_messages) > 30

        wait_until(has_received)
    assert set(robot.base_messages) == {b"ours"}


def _has_more_than(received: list[int], count: int) -> bool:
    return len(received) > count


def test_programs_on_the_robot_need_no_certificate(network: TlsNetwork, robot: TlsRobot) -> None:
    here = ZenohConfig(listen=(), connect=(f"tcp/{HOST}:{network.local_port}",))
    with open_session(here) as session, receive_pose_numbers(session):
        assert query_replies(session, "kinect/command/reset")


@pytest.mark.subprocess
@pytest.mark.parametrize("flooder", ["operator", "reader"])
def test_a_flood_of_commands_costs_a_normal_subscriber_no_pose(
    network: TlsNetwork, robot: TlsRobot, flooder: str
) -> None:
    file = network.file(f"{flooder}-tls.json5", f"ours/{flooder}")
    with (
        network.open_session("reader-tls.json5", "ours/reader") as reader,
        receive_pose_numbers(reader) as received,
    ):
        done = subprocess.run(
            [sys.executable, str(FLOOD), str(file), "1.0"],
            capture_output=True,
            text=True,
            check=True,
        )
        sent = int(done.stdout)
        wait_until(lambda: len(received) >= 50)
    assert is_contiguous(received)
    assert sent > 200
    assert len(robot.executed) < 60
    assert flooder == "operator" or not robot.executed
