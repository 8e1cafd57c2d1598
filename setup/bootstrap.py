"""Set up everything the project needs on a fresh Debian or Ubuntu, with nothing but Python 3.11+ and git.

    python3 setup/bootstrap.py [--dev | --bench]

Makes `.venv/`, installs the locked packages (and the project itself, editable), installs the system's EGL and Mesa
libraries through apt when they are missing, and compiles the kernels, so that the first request finds them warm. Does nothing
twice: what is already there is left alone. Standard library only.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
PYTHON = VENV / "bin" / "python"
STAMP = VENV / ".installed"
KERNEL_STAMP = VENV / ".kernels"
LOCKS = ("run", "dev", "bench")
"""Each holds all packages of those before it."""
KERNELS = ("geometry", "worker", "service", "tests")
COMPILERS = (("worker.warm",), ("service.warm",), ("service.warm", "--backwards"))
"""The service has more kernels than the workers: two compile them, from both ends."""

GL_LIBRARIES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libEGL_mesa.so.0": "libegl-mesa0",
}
GL_DRIVER_PACKAGE = "libgl1-mesa-dri"


def say(text: str) -> None:
    """One line of progress."""
    print(f"[setup] {text}", flush=True)


def stop(text: str) -> None:
    """End with a sentence that says what to do."""
    sys.exit(f"[setup] {text}")


def run(*command: str | Path, quiet: bool = False) -> None:
    """Run a command and end the set-up when it fails."""
    done = subprocess.run([str(part) for part in command], check=False, capture_output=quiet, text=True)
    if done.returncode:
        if quiet:
            sys.stderr.write(done.stdout + done.stderr)
        stop(f"`{' '.join(str(part) for part in command)}` failed with status {done.returncode}")


def apt_install(packages: list[str], why: str) -> None:
    """Install Debian packages, as root or through sudo; a clear sentence where that cannot be."""
    if not packages:
        return
    wanted = " ".join(packages)
    by_hand = f"run `apt-get install {wanted}` as root, then start again"
    if not shutil.which("apt-get"):
        stop(f"{why}, and this system has no apt-get: install what corresponds to {wanted} by hand, then start again")
    if os.geteuid() == 0:
        prefix = []
    elif shutil.which("sudo") and subprocess.run(["sudo", "-n", "true"], check=False, capture_output=True).returncode == 0:
        prefix = ["sudo", "-n"]
    elif shutil.which("sudo") and sys.stdin.isatty():
        prefix = ["sudo"]
    else:
        stop(f"{why}, and neither root nor sudo is at hand: {by_hand}")
    say(f"{why}: installing {wanted}")
    environment = ["env", "DEBIAN_FRONTEND=noninteractive"]
    run(*prefix, "apt-get", "update", quiet=True)
    run(*prefix, *environment, "apt-get", "install", "-y", "--no-install-recommends", *packages, quiet=True)


def loads(library: str) -> bool:
    """Whether the dynamic linker finds a library."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def install_gl() -> None:
    """EGL, OpenGL and a software driver, for rendering without a screen."""
    missing = [package for library, package in GL_LIBRARIES.items() if not loads(library)]
    folders = (f"/usr/lib/{triplet}/dri" for triplet in ("x86_64-linux-gnu", "aarch64-linux-gnu"))
    if missing or not any(Path(folder).is_dir() for folder in folders):
        apt_install([*missing, GL_DRIVER_PACKAGE], "rendering needs EGL and Mesa")


def make_environment() -> None:
    """The virtual environment at `.venv/`."""
    if PYTHON.exists():
        return
    try:
        import ensurepip  # noqa: F401
        import venv  # noqa: F401
    except ImportError:
        apt_install([f"python{sys.version_info.major}.{sys.version_info.minor}-venv"], "this Python has no venv module")
    say("creating .venv")
    run(sys.executable, "-m", "venv", VENV)


def install_packages(lock: str) -> None:
    """The locked packages with their hashes, and the project itself."""
    lock_file = ROOT / "requirements" / f"{lock}.lock"
    wanted = (*sorted((ROOT / "requirements").glob("*.lock")), ROOT / "pyproject.toml")
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in wanted)).hexdigest()
    installed = STAMP.read_text() if STAMP.exists() else ""
    if installed in [f"{digest} {larger}" for larger in LOCKS[LOCKS.index(lock) :]]:
        return
    say(f"installing the packages of {lock_file.relative_to(ROOT)}")
    pip = [PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]  # few modules are ever imported
    run(*pip, "--require-hashes", "-r", lock_file)
    run(*pip, "--no-deps", "--no-build-isolation", "--editable", ROOT, quiet=True)
    STAMP.write_text(f"{digest} {lock}")


def compile_kernels() -> None:
    """Compile all kernels anew when any source has changed: numba's cache does not see changes in the functions they call."""
    sources = sorted(path for folder in KERNELS for path in (ROOT / folder).rglob("*.py"))
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    if KERNEL_STAMP.exists() and KERNEL_STAMP.read_text() == digest:
        return
    for folder in KERNELS:
        for compiled in (ROOT / folder).rglob("__pycache__/*.nb[ic]"):
            compiled.unlink(missing_ok=True)
    say("compiling the kernels, once (some minutes)")
    compilers = [subprocess.Popen([PYTHON, "-m", *module], cwd=ROOT) for module in COMPILERS]
    statuses = [compiler.wait() for compiler in compilers]
    if any(statuses):
        stop("the kernels could not be compiled; the lines above say why")
    KERNEL_STAMP.write_text(digest)


def use_newer_python() -> None:
    """Go on under a Python that is new enough, when this one is not."""
    if sys.version_info >= (3, 11):  # noqa: UP036 - run by whatever Python is there
        return
    for name in ("python3.14", "python3.13", "python3.12", "python3.11"):
        if shutil.which(name) and subprocess.run([name, "-c", ""], check=False, capture_output=True).returncode == 0:
            os.execvp(name, [name, *sys.argv])
    stop(f"Python 3.11 or newer is needed, this is {sys.version.split()[0]}")


def main() -> None:
    """Do every step that is not done yet."""
    use_newer_python()
    lock = next((name for name in reversed(LOCKS) if f"--{name}" in sys.argv[1:]), "run")
    install_gl()
    make_environment()
    install_packages(lock)
    compile_kernels()


if __name__ == "__main__":
    main()
