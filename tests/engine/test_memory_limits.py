from pathlib import Path

import pytest

from holopath_addon.engine.memory import limit_files

ROOT = Path("/sys/fs/cgroup")


@pytest.mark.parametrize(
    ("groups", "files"),
    [
        ("", ["memory.max", "memory/memory.limit_in_bytes"]),
        ("0::/", ["memory.max", "memory/memory.limit_in_bytes"]),
        (
            "0::/user.slice/run-1.scope",
            [
                "memory.max",
                "memory/memory.limit_in_bytes",
                "user.slice/run-1.scope/memory.max",
                "user.slice/memory.max",
            ],
        ),
        (
            "7:cpu,cpuacct:/a\n3:memory:/slurm/job_5\nno group",
            [
                "memory.max",
                "memory/memory.limit_in_bytes",
                "memory/slurm/job_5/memory.limit_in_bytes",
                "memory/slurm/memory.limit_in_bytes",
            ],
        ),
    ],
)
def test_limits_of_control_groups(groups, files):
    """cgroups(7): those of the whole container, of services (version 2) and of batch jobs (version 1)."""
    assert limit_files(groups) == [ROOT / file for file in files]
