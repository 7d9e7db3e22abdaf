"""What releases: the flow calls the script that continuous integration runs, and the script does what the page says."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from places import DOCS, ROOT
from ruamel.yaml import YAML

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FLOWS = ROOT / ".github" / "workflows"


def flow(name: str) -> dict:
    return YAML(typ="safe", pure=True).load((FLOWS / name).read_text(encoding="utf-8"))


@pytest.fixture
def release() -> ModuleType:
    spec = importlib.util.spec_from_file_location("release", ROOT / ".ci" / "release.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def commands(release: ModuleType, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """The commands of the script, which are not run; repairing copies the wheel."""
    called: list[tuple[str, ...]] = []

    def call(*command: str, **_: object) -> None:
        called.append(command)
        if "repair" in command:
            into, wheel = Path(command[command.index("--wheel-dir") + 1]), Path(command[-1])
            (into / wheel.name.replace("linux", "manylinux")).write_bytes(b"")

    monkeypatch.setattr(release, "call", call)
    monkeypatch.setattr(release, "uv", call)
    monkeypatch.setattr(release.sys, "platform", "linux")
    return called


@pytest.mark.parametrize(
    ("name", "audited"), [("cp310-cp310", False), ("cp311-cp311", False), ("cp312-abi3", True), ("cp314-abi3", True)]
)
def test_only_a_wheel_of_the_stable_abi_is_audited_for_it(
    name: str, audited: bool, release: ModuleType, commands: list[tuple[str, ...]], tmp_path: Path
) -> None:
    made = release.repair(tmp_path / f"coopqp-1.0-{name}-linux_x86_64.whl", tmp_path / "repaired")
    assert made.name == f"coopqp-1.0-{name}-manylinux_x86_64.whl"
    assert any("abi3audit" in command for command in commands) == audited


@pytest.mark.parametrize("name", ["cp312-cp312", "cp310-abi3", "py3-none"])
def test_a_wheel_for_other_pythons_than_it_should_be_for_is_refused(
    name: str, release: ModuleType, commands: list[tuple[str, ...]], tmp_path: Path
) -> None:
    with pytest.raises(release.FailedError, match=r"from Python 3\.12 on a wheel is for all later ones"):
        release.repair(tmp_path / f"coopqp-1.0-{name}-linux_x86_64.whl", tmp_path)
    assert commands == []


def test_a_tag_that_names_another_version_is_refused(
    release: ModuleType, commands: list[tuple[str, ...]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert release.main(["sdist", str(tmp_path), "--tag", "v99.0"]) == 1
    assert "the tag v99.0 does not name the version" in capsys.readouterr().err
    assert commands == []


def test_pythons_that_are_missing_are_named(
    release: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(release, "python_at_hand", lambda version: None)
    monkeypatch.setenv("COOPQP_CI_LACKS", str(tmp_path / "lacks.txt"))
    (tmp_path / "coopqp-1.0.tar.gz").write_bytes(b"")
    assert release.main(["wheels", str(tmp_path)]) == 0
    said = [f"no Python {version} on this machine: no wheel for it" for version in release.SERVED]
    assert (tmp_path / "lacks.txt").read_text(encoding="utf-8").splitlines() == said
    assert capsys.readouterr().out.count("no Python 3.12 on this machine") == 2


def test_the_flow_and_continuous_integration_call_the_same_script(release: ModuleType) -> None:
    runs = [step["run"] for job in flow("release.yml")["jobs"].values() for step in job["steps"] if "run" in step]
    assert [run for run in runs if "release.py sdist" in run] == ['python .ci/release.py sdist dist --tag "$TAG"']
    wheels = PROJECT["tool"]["cibuildwheel"]
    assert wheels["repair-wheel-command"] == "python {project}/.ci/release.py repair {wheel} {dest_dir}"
    assert "tests/installed.py" in wheels["test-command"]
    assert wheels["build-frontend"] == "build[uv]"
    assert any(re.search(r'pip install "cibuildwheel[^"]*" uv', run) for run in runs), "on macOS uv comes with no image"
    assert ".ci/environments.py release" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "from release import" in (ROOT / ".ci" / "environments.py").read_text(encoding="utf-8")


def test_the_pythons_of_wheels_are_those_of_classifiers_and_flows(release: ModuleType) -> None:
    served = {version for versions in release.SERVED.values() for version in versions}
    named = {
        text.rpartition(" ")[2] for text in PROJECT["project"]["classifiers"] if re.search(r"Python :: 3\.\d+$", text)
    }
    built = {re.sub(r"cp3(\d+)-\*", r"3.\1", name) for name in PROJECT["tool"]["cibuildwheel"]["build"]}
    (setup,) = (s["with"] for s in flow("ci.yml")["jobs"]["run"]["steps"] if "setup-python" in s.get("uses", ""))
    assert served == named == built == set(setup["python-version"].split())


def test_scripts_that_the_flows_name_are_there() -> None:
    for file in FLOWS.glob("*.yml"):
        for script in re.findall(r"(?:python|bash) (\.ci/\S+)", file.read_text(encoding="utf-8")):
            assert (ROOT / script).is_file(), script


def test_version_changelog_and_citation_name_the_same_release() -> None:
    """Above the newest release stands what is not released yet."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    heads = re.findall(r"^## \[(.+?)\](?: – (\d{4}-\d{2}-\d{2}))?$", text, flags=re.M)
    assert heads[0] == ("Unreleased", "")
    version, day = heads[1]
    cited = YAML(typ="safe", pure=True).load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    source = (ROOT / "coopqp" / "version.py").read_text(encoding="utf-8")
    assert f'__version__ = "{version}"' in source
    assert (str(cited["version"]), str(cited["date-released"])) == (version, day)


def test_the_page_names_each_file_of_a_release() -> None:
    page = (DOCS / "releasing.md").read_text(encoding="utf-8")
    for name in (
        "coopqp/version.py", "CHANGELOG.md", "CITATION.cff", ".ci/release.py", ".github/workflows/release.yml",
        "pyproject.toml",
    ):  # fmt: skip
        assert f"`{name}`" in page, name
        assert (ROOT / name).is_file(), name
