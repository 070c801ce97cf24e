"""Builds wheel and sdist (PEP 517, 427, 643) with the standard library alone, so that no network is needed. The same sources
make the same bytes.

    python3 build_backend.py FOLDER      both files, in FOLDER
"""
import base64
import gzip
import hashlib
import io
import pathlib
import re
import sys
import tarfile
import zipfile

HERE = pathlib.Path(__file__).resolve().parent
PACKAGE = "authros_verify"
SOURCES = ("LICENSE", "README.md", "build_backend.py", "pyproject.toml")
# The oldest time that a ZIP file can state.
THEN = 315532800


def line(name):
    """The value of a line of pyproject.toml."""
    text = (HERE / "pyproject.toml").read_text(encoding="utf-8")
    return re.search(rf'^{name} = "(.+)"$', text, re.MULTILINE).group(1)


def modules():
    """The files of the package by their names in an archive; links are followed."""
    return {f"{PACKAGE}/{path.name}": path.read_bytes() for path in sorted((HERE / PACKAGE).iterdir()) if path.is_file()}


def metadata():
    fields = (
        ("Metadata-Version", "2.4"), ("Name", line("name")), ("Version", line("version")), ("Summary", line("description")),
        ("Author", "The AuthROS authors"), ("License-Expression", line("license")), ("License-File", "LICENSE"),
        ("Requires-Python", line("requires-python")), ("Description-Content-Type", "text/markdown"),
    )
    return ("".join(f"{name}: {value}\n" for name, value in fields) + "\n").encode() + (HERE / "README.md").read_bytes()


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    version = line("version")
    about = f"{PACKAGE}-{version}.dist-info"
    files = modules()
    files[f"{about}/licenses/LICENSE"] = (HERE / "LICENSE").read_bytes()
    files[f"{about}/METADATA"] = metadata()
    files[f"{about}/WHEEL"] = b"Wheel-Version: 1.0\nGenerator: build_backend\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    files[f"{about}/entry_points.txt"] = f"[console_scripts]\nauthros-verify = {line('authros-verify')}\n".encode()
    digest = lambda data: base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
    listed = [f"{name},sha256={digest(data)},{len(data)}" for name, data in files.items()] + [f"{about}/RECORD,,"]
    files[f"{about}/RECORD"] = ("\n".join(listed) + "\n").encode()
    name = f"{PACKAGE}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(pathlib.Path(wheel_directory) / name, "w") as wheel:
        for path, data in files.items():
            member = zipfile.ZipInfo(path)
            member.external_attr = 0o100644 << 16
            wheel.writestr(member, data)
    return name


def build_sdist(sdist_directory, config_settings=None):
    folder = f"{PACKAGE}-{line('version')}"
    files = {**{name: (HERE / name).read_bytes() for name in SOURCES}, **modules(), "PKG-INFO": metadata()}
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name, data in sorted(files.items()):
            member = tarfile.TarInfo(f"{folder}/{name}")
            member.size, member.mtime, member.mode = len(data), THEN, 0o644
            archive.addfile(member, io.BytesIO(data))
    (pathlib.Path(sdist_directory) / f"{folder}.tar.gz").write_bytes(gzip.compress(packed.getvalue(), 9, mtime=THEN))
    return f"{folder}.tar.gz"


if __name__ == "__main__":
    for build in (build_wheel, build_sdist):
        print(build(sys.argv[1]))
