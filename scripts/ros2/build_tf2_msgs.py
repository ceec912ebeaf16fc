"""Build the package tf2_msgs, with TFMessage only, into the ROS 2 environment of this Python.

ROS's generators write the code as for any package. CMake would compile it to five libraries for all
middlewares, with twenty more packages from PyPI. One call of the compiler makes an extension module
for Fast DDS of ROS 2 kilted and later; that of jazzy needs more.

Usage: .ros2/kilted/bin/python scripts/ros2/build_tf2_msgs.py    (see scripts/setup_ros2.sh)
"""

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import numpy as np
from rosidl_generator_c.cli import GenerateC
from rosidl_generator_py.cli import GeneratePython
from rosidl_generator_type_description.cli import HashTypeDescription
from rosidl_typesupport_c.cli import GenerateCTypesupport
from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport

PACKAGE = "tf2_msgs"
MESSAGE = """
#include "geometry_msgs/msg/TransformStamped.idl"

module tf2_msgs {
  module msg {
    struct TFMessage {
      sequence<geometry_msgs::msg::TransformStamped> transforms;
    };
  };
};
"""
# rclpy looks for type support for any middleware under this name.
MODULE = f"{PACKAGE}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
LIBRARIES = (
    "geometry_msgs__rosidl_generator_c",
    "geometry_msgs__rosidl_generator_py",
    "geometry_msgs__rosidl_typesupport_fastrtps_c",
    "rosidl_runtime_c",
    "rosidl_typesupport_fastrtps_c",
    "fastcdr",
    "stdc++",
)
PREFIX = Path(sys.prefix)


def generate_code(folder: Path) -> None:
    """Write the Python package with the C and C++ sources of its extension into a folder."""
    source = folder.parent / "source"
    file = source / "msg" / "TFMessage.idl"
    file.parent.mkdir(parents=True)
    file.write_text(MESSAGE)
    task = (PACKAGE, [f"{source}:{file.relative_to(source)}"], [str(PREFIX / "share")], folder)
    os.environ["AMENT_PREFIX_PATH"] = str(PREFIX)  # where the generators look for their templates
    hashes = HashTypeDescription("hash").generate_type_hashes(*task)
    GenerateC("c").generate(*task, type_description_files=hashes)
    GenerateFastRTPSCTypesupport("fastrtps_c").generate(*task)
    only_fast_dds = ["rosidl_typesupport_fastrtps_c"]
    GenerateCTypesupport("c", typesupport_implementations=only_fast_dds).generate(*task)
    any_middleware = ["rosidl_typesupport_c"]
    GeneratePython("py", typesupport_implementations=any_middleware).generate(*task)
    (folder / "__init__.py").touch()


def compile_extension(folder: Path) -> None:
    """Compile the sources in a package's folder to one extension module.

    Raises:
        subprocess.CalledProcessError: The compiler failed, and has printed why.
    """
    headers = PREFIX / "include"
    places = [".", headers, *headers.iterdir(), sysconfig.get_path("include"), np.get_include()]
    command: list[str | Path] = ["gcc", "-shared", "-fPIC", "-O1", "-o", folder / MODULE]
    command += [f"-I{place}" for place in places]
    command += [file.relative_to(folder.parent) for file in folder.rglob("*.c*")]
    command += [f"-L{PREFIX / 'lib'}", *(f"-l{name}" for name in LIBRARIES)]
    subprocess.run(command, check=True, cwd=folder.parent)


def main() -> None:
    """Build the package and install it."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / PACKAGE
        generate_code(folder)
        compile_extension(folder)
        only_for_the_compiler = shutil.ignore_patterns("*.c", "*.cpp", "*.h", "*.json", "detail")
        installed = Path(sysconfig.get_path("platlib")) / PACKAGE
        shutil.copytree(folder, installed, ignore=only_for_the_compiler, dirs_exist_ok=True)


if __name__ == "__main__":
    main()
