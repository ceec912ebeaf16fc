"""A ROS program for the tests of the node: reads topics, calls a service, sets a parameter.

Usage: PYTHON ros_program.py read COUNT TOPIC=PACKAGE/TYPE ...   prints COUNT messages of each topic
       PYTHON ros_program.py call SERVICE TYPE                   prints the response of std_srvs
       PYTHON ros_program.py set NODE PARAMETER VALUE            prints whether and why not
       PYTHON ros_program.py send TOPIC PACKAGE/TYPE PAYLOAD     publishes it once somebody reads

A message is printed as TOPIC and its CDR bytes in hexadecimal digits. TOPIC with a plus sign before
it is latched. VALUE is JSON.
"""

import json
import sys
import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

BEST_EFFORT = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def find_type(name: str, kind: str = "msg") -> Any:
    package, _, message = name.partition("/")
    return getattr(import_module(f"{package}.{kind}"), message)


def read(node: Node, count: str, *topics: str) -> None:
    missing = {topic.partition("=")[0].lstrip("+"): int(count) for topic in topics}

    def subscribe(topic: str, message: Any, qos: QoSProfile) -> None:
        def on_message(payload: bytes) -> None:
            if missing.get(topic):
                missing[topic] -= 1
                print(topic, payload.hex(), flush=True)

        node.create_subscription(message, topic, on_message, qos, raw=True)

    for topic in topics:
        name, _, message = topic.partition("=")
        qos = LATCHED if name.startswith("+") else BEST_EFFORT
        subscribe(name.lstrip("+"), find_type(message), qos)
    print("ready", flush=True)
    while any(missing.values()):
        rclpy.spin_once(node)


def ask(node: Node, kind: Any, service: str, request: Any) -> Any:
    client = node.create_client(kind, service)
    client.wait_for_service()
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future)
    return future.result()


def call(node: Node, service: str, name: str) -> None:
    kind = find_type(f"std_srvs/{name}", "srv")
    response = ask(node, kind, service, kind.Request())
    print(getattr(response, "success", None), getattr(response, "message", ""))


def set_parameter(node: Node, other: str, name: str, value: str) -> None:
    parameter = Parameter(name, value=json.loads(value)).to_parameter_msg()
    request = SetParameters.Request(parameters=[parameter])
    (result,) = ask(node, SetParameters, f"{other}/set_parameters", request).results
    print(result.successful, result.reason)


def send(node: Node, topic: str, message: str, payload: str) -> None:
    publisher = node.create_publisher(find_type(message), topic, 10)
    while not publisher.get_subscription_count():
        rclpy.spin_once(node, timeout_sec=0.05)
    publisher.publish(bytes.fromhex(payload))
    time.sleep(0.5)  # it is sent in the background


COMMANDS: dict[str, Callable[..., None]] = {
    "read": read,
    "call": call,
    "set": set_parameter,
    "send": send,
}

if __name__ == "__main__":
    rclpy.init()
    COMMANDS[sys.argv[1]](rclpy.create_node("test_program"), *sys.argv[2:])
    rclpy.shutdown()
