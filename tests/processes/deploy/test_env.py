"""The script that makes the environment, as far as it needs no network, and the lock files."""

from __future__ import annotations

import ast
import fcntl
import io
import os
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from formation.deploy import env

DEV = (env.LOCK / "dev.txt").read_text(encoding="utf-8")
ROBOT = (env.LOCK / "agent.txt").read_text(encoding="utf-8")
PYPROJECT: dict[str, Any] = tomllib.loads((env.ROOT / "pyproject.toml").read_text(encoding="utf-8"))


class Terminal(io.StringIO):
    """A stream that reports to be a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder in which the script keeps environments."""
    monkeypatch.setattr(env, "STORE", tmp_path / ".venvs")
    monkeypatch.setattr(env, "LINK", tmp_path / ".venv")
    (tmp_path / ".venvs").mkdir()
    return tmp_path / ".venvs"


def finished(store: Path, name: str, age: float = 0.0) -> Path:
    """An environment that was installed `age` [s] ago."""
    environment = store / name
    (environment / "bin").mkdir(parents=True)
    (environment / "bin" / "python").symlink_to(sys.executable)
    (environment / env.DONE).touch()
    made = environment.stat().st_mtime - age
    os.utime(environment, (made, made))
    return environment


def checkout(
    root: Path, lock: str = "numpy==2.4.6\n", name: str = "formation", line_length: int = 110
) -> Path:
    """A checkout with the two files from which an environment is made."""
    (root / "deploy" / "lock").mkdir(parents=True, exist_ok=True)
    (root / "deploy" / "lock" / "dev.txt").write_text(lock, encoding="utf-8")
    (root / "pyproject.toml").write_text(
        f'[build-system]\nrequires = []\n[project]\nname = "{name}"\n[tool.hatch]\n'
        f"[tool.ruff]\nline-length = {line_length}\n",
        encoding="utf-8",
    )
    return root


def key(root: Path) -> str:
    return env.key_of(root, (3, 11), "aarch64")


# ---- requirements of the script ----


def test_script_imports_only_standard_library() -> None:
    tree = ast.parse(Path(env.__file__).read_text(encoding="utf-8"))
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert names
    assert {name.split(".")[0] for name in names} <= sys.stdlib_module_names


def test_script_parses_on_old_python_and_refuses_it() -> None:
    source = Path(env.__file__).read_text(encoding="utf-8")
    tree = ast.parse(source, feature_version=(3, 7))
    at_the_top = [ast.unparse(node) for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    assert "import tomllib" not in at_the_top
    with pytest.raises(
        env.SetupError, match=r"Python 3\.10 is too old: start this with Python 3\.11 or newer"
    ):
        env.refuse_unfit_system((3, 10), "posix")


def test_non_posix_system_is_refused_with_advice() -> None:
    with pytest.raises(env.SetupError, match="use WSL"):
        env.refuse_unfit_system((3, 13), "nt")


@pytest.mark.parametrize("version", [(3, 11), (3, 13), (4, 0)])
def test_newer_pythons_are_accepted(version: tuple[int, int]) -> None:
    env.refuse_unfit_system(version, "posix")


# ---- keys, link and removal of environments ----


def test_same_checkout_has_same_key(tmp_path: Path) -> None:
    assert key(checkout(tmp_path)) == key(checkout(tmp_path))


def test_key_depends_on_lock_project_and_path(tmp_path: Path) -> None:
    keys = {
        key(checkout(tmp_path / "a")),
        key(checkout(tmp_path / "a", lock="numpy==2.5.5\n")),
        key(checkout(tmp_path / "a", name="other")),
        key(checkout(tmp_path / "b")),
    }
    assert len(keys) == 4


def test_key_depends_on_python_and_machine(tmp_path: Path) -> None:
    root = checkout(tmp_path)
    pairs = [((3, 11), "aarch64"), ((3, 12), "aarch64"), ((3, 11), "x86_64")]
    assert len({env.key_of(root, version, machine) for version, machine in pairs}) == 3


def test_key_ignores_tool_settings(tmp_path: Path) -> None:
    assert key(checkout(tmp_path, line_length=110)) == key(checkout(tmp_path, line_length=100))


def test_finished_environment_is_in_use_after_link(store: Path) -> None:
    environment = finished(store, "new")
    assert not env.in_use(environment)
    env.link_environment(env.LINK, environment)
    assert env.in_use(environment)


def test_interrupted_installation_is_not_in_use(store: Path) -> None:
    environment = finished(store, "half")
    env.link_environment(env.LINK, environment)
    (environment / env.DONE).unlink()
    assert not env.in_use(environment)


def test_environment_without_python_is_not_in_use(store: Path) -> None:
    environment = finished(store, "orphan")
    env.link_environment(env.LINK, environment)
    (environment / "bin" / "python").unlink()
    (environment / "bin" / "python").symlink_to(store / "gone")
    assert not env.in_use(environment)


def test_point_moves_link_to_new_environment(store: Path) -> None:
    old, new = finished(store, "old"), finished(store, "new")
    env.link_environment(env.LINK, old)
    env.link_environment(env.LINK, new)
    assert env.LINK.resolve() == new
    assert sorted(path.name for path in store.parent.iterdir()) == [".venv", ".venvs"]


def test_link_refuses_to_replace_foreign_folder(store: Path) -> None:
    env.LINK.mkdir()
    with pytest.raises(env.SetupError, match="is not a link: move or remove it"):
        env.link_environment(env.LINK, finished(store, "new"))
    assert env.LINK.is_dir()
    assert not env.LINK.is_symlink()


def test_forget_old_keeps_newest_environments(store: Path) -> None:
    made = [finished(store, f"made{age}", age=age) for age in (0, 100, 200, 300)]
    env.remove_old(made[0])
    assert [path.exists() for path in made] == [True, True, True, False]


def test_forget_old_keeps_current_environment(store: Path) -> None:
    made = [finished(store, f"made{age}", age=age) for age in (0, 100, 200, 300)]
    env.remove_old(made[3])
    assert [path.exists() for path in made] == [True, True, False, True]


def test_only_one_process_installs_at_a_time(store: Path) -> None:
    with (store / "lock").open("w") as other:
        with env.installation_lock(), pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)


# ---- pip and commands ----


@pytest.mark.parametrize(
    ("text", "number"), [("23.0.1 from /usr (python 3.11)", (23, 0, 1)), ("22.3rc1", (22, 3)), ("", ())]
)
def test_release_parses_pip_version_output(text: str, number: tuple[int, ...]) -> None:
    assert env.release(text) == number


def test_new_environment_uses_external_pip_without_ensurepip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(env, "has_module", lambda _, name: name != "ensurepip")
    monkeypatch.setattr(env, "find_pip", lambda: ["pip3"])
    command = env.new_environment(tmp_path / "made")
    assert command == ["pip3", "--python", str(tmp_path / "made" / "bin" / "python")]
    assert (tmp_path / "made" / "bin" / "python").exists()


@pytest.mark.parametrize(("modules", "pip"), [({"venv"}, None), (set(), ["pip3"])])
def test_missing_venv_or_pip_names_package_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, modules: set[str], pip: list[str] | None
) -> None:
    monkeypatch.setattr(env, "has_module", lambda _, name: name in modules)
    monkeypatch.setattr(env, "find_pip", lambda: pip)
    with pytest.raises(env.SetupError, match=r"sudo apt install python3\.\d+-venv$"):
        env.new_environment(tmp_path / "made")


def test_error_contains_output_of_failed_pip() -> None:
    command = [sys.executable, "-c", "print('no matching distribution'); raise SystemExit(1)"]
    with pytest.raises(env.SetupError, match="no matching distribution"):
        env.run_pip(command, env.Progress(1, io.StringIO()))


def test_run_pip_keeps_configuration_but_disables_user_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIP_USER", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", "/media/usb")
    show = "import os, sys; sys.exit(' '.join([os.environ['PIP_USER'], os.environ['PIP_FIND_LINKS']]))"
    with pytest.raises(env.SetupError, match="0 /media/usb"):
        env.run_pip([sys.executable, "-c", show], env.Progress(1, io.StringIO()))


def test_own_variables_lack_python_variables_of_ros() -> None:
    variables = {"PYTHONPATH": "/opt/ros/jazzy/lib", "PYTHONHOME": "/usr", "ROS_DISTRO": "jazzy"}
    assert env.own_variables(variables) == {"ROS_DISTRO": "jazzy"}


def test_missing_command_is_refused_by_name(store: Path) -> None:
    with pytest.raises(env.SetupError, match="there is no command 'formatoin'"):
        env.exec_command(finished(store, "new"), ["formatoin", "run"])


def test_path_is_refused_as_command(store: Path) -> None:
    with pytest.raises(env.SetupError, match="there is no command"):
        env.exec_command(finished(store, "new"), ["../bin/python"])


# ---- progress ----


def test_progress_counts_packages_on_terminal() -> None:
    stream = Terminal()
    progress = env.Progress(2, stream)
    progress.process_line("Collecting numpy==2.4.6 (from -r dev.txt (line 3))")
    progress.process_line("Collecting rich==15.0.0 (from -r dev.txt (line 9))")
    assert "1/2 numpy==2.4.6" in stream.getvalue()
    assert "2/2 rich==15.0.0" in stream.getvalue()


def test_progress_in_log_has_only_first_and_last_line() -> None:
    stream = io.StringIO()
    progress = env.Progress(1, stream)
    progress.start("installing")
    progress.process_line("Collecting numpy==2.4.6")
    progress.end("installed")
    assert re.fullmatch(r"installing\ninstalled in \d+ s\n", stream.getvalue())


# ---- lock files ----


def locked(text: str) -> dict[str, set[str]]:
    """Name -> versions that a lock file pins it to, one per range of Pythons."""
    found: dict[str, set[str]] = {}
    for name, version in re.findall(r"^([\w.-]+)==(\S+)", text, flags=re.MULTILINE):
        found.setdefault(name, set()).add(version)
    return found


def project_requirements() -> list[Requirement]:
    """Requirements in pyproject.toml, without the project itself, included groups and benchmark peers."""
    project = PYPROJECT["project"]
    lists = [
        PYPROJECT["build-system"]["requires"],
        project["dependencies"],
        *project["optional-dependencies"].values(),
        *(group for name, group in PYPROJECT["dependency-groups"].items() if name != "bench"),
    ]
    requirements = [Requirement(item) for some in lists for item in some if isinstance(item, str)]
    return [requirement for requirement in requirements if requirement.name != project["name"]]


@pytest.mark.parametrize("requirement", project_requirements(), ids=str)
def test_lock_satisfies_project_requirement(requirement: Requirement) -> None:
    versions = locked(DEV)[canonicalize_name(requirement.name)]
    assert all(requirement.specifier.contains(version) for version in versions)


def test_agent_lock_has_dependencies_but_no_desk_packages() -> None:
    base = {Requirement(item).name for item in PYPROJECT["project"]["dependencies"]}
    assert base <= locked(ROBOT).keys()
    assert locked(ROBOT).keys().isdisjoint({"mcap", "rich", "matplotlib", "pytest", "mypy", "ruff"})


@pytest.mark.parametrize("text", [DEV, ROBOT], ids=["dev", "agent"])
def test_locks_exclude_benchmark_peers(text: str) -> None:
    assert locked(text).keys().isdisjoint({"ir-sim", "cvxopt"})


def test_agent_lock_pins_same_versions_as_dev_lock() -> None:
    assert locked(ROBOT).items() <= locked(DEV).items()


@pytest.mark.parametrize("text", [DEV, ROBOT], ids=["dev", "agent"])
def test_every_pin_has_a_hash(text: str) -> None:
    blocks = re.split(r"^(?=[\w.-]+==)", text, flags=re.MULTILINE)
    unhashed = [block.split()[0] for block in blocks[1:] if "--hash=sha256:" not in block]
    assert {"eclipse-zenoh", "numpy", "pydantic"} <= {block.split("==")[0] for block in blocks}
    assert unhashed == []


@pytest.mark.parametrize("text", [DEV, ROBOT], ids=["dev", "agent"])
def test_lock_names_no_host(text: str) -> None:
    assert "://" not in text
    assert "--index" not in text


def test_pins_returns_package_names_of_lock() -> None:
    assert env.pins(
        "numpy==2.4.6 ; x\n    --hash=sha256:00\nnumpy==2.5.5\nrich==15.0.0\n    # via a==b\n"
    ) == {
        "numpy",
        "rich",
    }
