# SPDX-License-Identifier: Apache-2.0
"""What holds for the repository as a whole."""

import ast
import subprocess
import sys
import tomllib
import zipfile
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "skyhaul"
MODULES = sorted(PACKAGE.rglob("*.py"))
BIN = Path(sys.executable).parent


def name_of(path: Path) -> str:
    """Dotted name of a module of the package."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def body(path: Path) -> ast.Module:
    """A module, parsed."""
    return ast.parse(path.read_text("utf-8"))


def test_the_import_contract_holds() -> None:
    command = [BIN / "lint-imports", "--no-cache"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout[-3000:]
    assert "0 broken" in result.stdout


def test_every_layer_of_the_tree_is_in_the_contract() -> None:
    contract = (ROOT / ".importlinter").read_text("utf-8")
    for path in PACKAGE.iterdir():
        if path.is_dir() and (path / "__init__.py").is_file():
            assert f"    skyhaul.{path.name}\n" in contract, path.name


def test_every_module_names_its_licence_and_says_what_it_is() -> None:
    for path in [*MODULES, *(ROOT / "tests").rglob("*.py"), *(ROOT / "benchmarks").glob("*.py")]:
        lines = path.read_text("utf-8").splitlines()
        assert "SPDX-License-Identifier: Apache-2.0" in "".join(lines[:2]), path
    for path in MODULES:
        assert ast.get_docstring(body(path)), path


def test_files_and_functions_stay_within_the_budget() -> None:
    for path in MODULES:
        assert len(path.read_text("utf-8").splitlines()) <= 400, path
        for node in ast.walk(body(path)):
            if isinstance(node, ast.FunctionDef):
                words = (ast.get_docstring(node, clean=False) or "").count("\n")
                assert node.end_lineno is not None
                assert node.end_lineno - node.lineno - words < 60, f"{path}: {node.name}"


def test_no_module_is_a_drawer() -> None:
    names = {part for path in MODULES for part in name_of(path).split(".")}
    assert not names & {"utils", "util", "common", "helpers", "core", "misc"}


def test_every_parameter_has_a_line_of_documentation() -> None:
    for path in MODULES:
        for node in ast.walk(body(path)):
            if isinstance(node, ast.ClassDef) and any(
                isinstance(b, ast.Name) and b.id == "Params" for b in node.bases
            ):
                for field, after in zip(node.body, [*node.body[1:], None], strict=True):
                    if isinstance(field, ast.AnnAssign) and ast.unparse(field.target) != "kind":
                        documented = isinstance(after, ast.Expr) and isinstance(
                            after.value, ast.Constant
                        )
                        assert documented, f"{path}: {node.name}.{ast.unparse(field.target)}"


@pytest.mark.parametrize("path", [p for p in MODULES if p.name == "__init__.py"], ids=name_of)
def test_packages_export_exactly_what_they_name(path: Path) -> None:
    imported = {
        alias.asname or alias.name
        for node in body(path).body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    module = import_module(name_of(path))
    named = getattr(module, "__all__", [])
    assert imported <= set(named)
    assert all(hasattr(module, name) for name in named)


def test_nothing_unfinished_is_left() -> None:
    for path in MODULES:
        text = path.read_text("utf-8")
        for word in ("TODO", "FIXME", "XXX", "NotImplementedError"):
            assert word not in text, f"{path}: {word}"


def _plain(name: str) -> str:
    """A distribution's name as indexes compare it."""
    return name.lower().replace("_", "-").replace(".", "-")


def test_the_lock_file_pins_every_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    wanted = [*project["project"]["dependencies"], *project["dependency-groups"]["dev"]]
    wanted += [d for extra in project["project"]["optional-dependencies"].values() for d in extra]
    lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    pins = {_plain(line.split("==")[0]) for line in lines if "==" in line}
    for requirement in wanted:
        name = requirement.split(">")[0].split("<")[0].split("=")[0].strip()
        assert _plain(name) in pins, name


def test_the_built_wheel_imports_and_carries_its_data(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, capture_output=True, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        packed = set(archive.namelist())
        archive.extractall(tmp_path / "site")
    ours = {p.relative_to(PACKAGE.parent).as_posix() for p in PACKAGE.rglob("*") if p.is_file()}
    assert {p for p in ours if "__pycache__" not in p} <= packed
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path / 'site')!r})\n"
        "import skyhaul, skyhaul.world.load as load\n"
        "from skyhaul.world.scenario import Scenario\n"
        "assert load.load_config(Scenario, 'hover').name == 'hover'\n"
        "print(skyhaul.__file__)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert result.stdout.strip().startswith(str(tmp_path / "site"))
