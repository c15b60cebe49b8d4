# SPDX-License-Identifier: Apache-2.0
"""Build of the ament_python package, the same file for `colcon build` and for `pip install`."""

import re
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "tactile_hand_ros"
ROOT = Path(__file__).resolve().parent


def version() -> str:
    """Read the version from package.xml, the one place that states it for ROS."""
    found = re.search(r"<version>([^<]+)</version>", (ROOT / "package.xml").read_text("utf-8"))
    assert found, "package.xml has no <version>"
    return found.group(1)


def installed_tree(folder: str) -> list:
    """List `folder` recursively as data_files below share/, paths relative as setuptools asks."""
    files: dict = {}
    for path in sorted((ROOT / folder).rglob("*")):
        if path.is_file() and not path.name.startswith("."):
            relative = path.relative_to(ROOT)
            files.setdefault(f"share/{PACKAGE}/{relative.parent}", []).append(str(relative))
    return list(files.items())


def executables() -> list:
    """List scripts/: data files keep their run bit and land where `ros2 run` looks.

    An entry point would not do: pip puts those into bin/ and ignores setup.cfg's install_scripts.
    """
    scripts = (ROOT / "scripts").iterdir()
    return sorted(f"scripts/{path.name}" for path in scripts if path.is_file())


setup(
    name=PACKAGE,
    version=version(),
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={
        PACKAGE: ["py.typed"],
        f"{PACKAGE}.report": ["template.html", "viewer.js", "viewer.css"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *installed_tree("config"),
        *installed_tree("launch"),
        (f"lib/{PACKAGE}", executables()),
    ],
    entry_points={"console_scripts": [f"tactile-hand = {PACKAGE}.cli:main"]},
    python_requires=">=3.10",
    # rclpy and the message packages come from apt or from requirements/ros.txt, never from here.
    install_requires=[
        "numpy>=1.26,<3",
        "osqp>=1.0,<2",
        "pin>=3.4,<5",
        "mcap>=1.2,<2",
        "zstandard>=0.22,<1",
        "lz4>=4.3,<5",
        "rosbags>=0.10,<0.12",
        "pydantic>=2.6,<3",
        "pyyaml>=6.0,<7",
    ],
    extras_require={
        "cli": ["typer>=0.12.4,<1", "rich>=13,<15", "psutil>=5.9,<8"],
        "cockpit": ["aiohttp>=3.9,<4"],
        "figures": ["matplotlib>=3.6,<4", "scipy>=1.11,<2"],
        "mesh": ["trimesh>=4.4"],
        "fast": ["numba>=0.60"],
        "foxglove": ["foxglove-sdk>=0.30,<1"],
        "mujoco": ["mujoco-core>=4,<5; python_version >= '3.11'"],
        "study": ["joblib>=1.3,<2", "dask>=2024.1", "distributed>=2024.1"],
        "test": ["pytest>=7.4", "pytest-timeout>=2.2", "hypothesis>=6.98"],
    },
    zip_safe=False,
    description="Tactile in-hand manipulation for ROS 2, in simulation so far",
    long_description=(ROOT / "README.md").read_text("utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    license_files=["LICENSE", "NOTICE"],
    maintainer="The tactile_hand_ros authors",
    maintainer_email="maintainers@tactile-hand-ros.invalid",
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Topic :: Scientific/Engineering",
        "Typing :: Typed",
    ],
)
