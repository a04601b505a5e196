"""Check a release: build wheel and sdist, compare their files with git, run the wheel away from the checkout.

`make release-check` runs it and leaves both files in ``dist``.
"""

import os
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Final

from tests.pages import ROOT

PACKAGES: Final = {"operators", "connectors", "storage", "flows"}
COMMANDS: Final = (  # each needs other data files of the package
    "demo --for 3s --out recordings --no-browser",
    "verify recordings",
    "check live --set detector=frequency_cnn",
    "simulate tiny --plan tiny",
    "fetch",
)


def run(*command: str | Path, cwd: Path, env: dict[str, str] | None = None) -> str:
    """Run a command and return its output; print it and end if the command fails."""
    done = subprocess.run(
        command, cwd=cwd, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}: exit code {done.returncode}\n{done.stdout}")
    return done.stdout


def tracked() -> set[str]:
    """Return the files of the checkout that git tracks."""
    return {name for name in run("git", "ls-files", "-z", cwd=ROOT).split("\0") if name}


def differences(built: Iterable[str], expected: set[str]) -> list[str]:
    """Return a line for each file that is in only one of both.

    >>> differences(["a", "b"], {"a", "c"})
    ['not in git: b', 'missing: c']
    """
    found = set(built)
    extra = [f"not in git: {name}" for name in sorted(found - expected)]
    return extra + [f"missing: {name}" for name in sorted(expected - found)]


def check_contents(sdist: Path, wheel: Path) -> list[str]:
    """Return the differences of both files from git."""
    files = tracked()
    with tarfile.open(sdist) as archive:
        names = [PurePosixPath(each.name) for each in archive if each.isfile()]
    found = differences((str(name.relative_to(name.parts[0])) for name in names), files | {"PKG-INFO"})
    with zipfile.ZipFile(wheel) as packed:
        own = [name for name in packed.namelist() if ".dist-info/" not in name]
    return found + differences(own, {name for name in files if name.split("/")[0] in PACKAGES})


def check_wheel(wheel: Path, folder: Path) -> None:
    """Install a wheel into a new environment in `folder`, and run commands there."""
    run(sys.executable, "-m", "venv", folder / "venv", cwd=folder)
    python = folder / "venv" / "bin" / "python"
    run(python, "-m", "pip", "install", "--quiet", "--no-compile", str(wheel), cwd=folder)
    env = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    env |= {"XDG_STATE_HOME": str(folder / "state")}
    slipflow = python.with_name("slipflow")
    version = run(slipflow, "--version", cwd=folder, env=env).strip()
    assert version == f"slipflow {wheel.name.split('-')[1]}", version
    where = run(python, "-c", "import flows; print(flows.__file__)", cwd=folder, env=env)
    assert where.startswith(str(folder)), where
    for command in COMMANDS:
        started = time.monotonic()
        run(slipflow, *command.split(), cwd=folder, env=env)
        print(f"{time.monotonic() - started:5.1f} s  slipflow {command}")


def main() -> None:
    """Build and check, and print the time of each step."""
    started, out = time.monotonic(), ROOT / "dist"
    with tempfile.TemporaryDirectory() as folder:
        run(sys.executable, "-m", "build", "--quiet", "--outdir", folder, ROOT, cwd=ROOT)
        [sdist], [wheel] = (list(Path(folder).glob(each)) for each in ("*.tar.gz", "*.whl"))
        print(f"{time.monotonic() - started:5.1f} s  built {sdist.name} and {wheel.name}")
        if found := check_contents(sdist, wheel):
            sys.exit("\n".join(found))
        print("         both have the files that git has")
        check_wheel(wheel, Path(folder))
        out.mkdir(exist_ok=True)
        for each in (sdist, wheel):
            (out / each.name).write_bytes(each.read_bytes())
    print(f"{time.monotonic() - started:5.1f} s  in total; wrote {out}")


if __name__ == "__main__":
    main()
