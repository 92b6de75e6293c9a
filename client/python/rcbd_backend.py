"""Builds the package for pip (PEP 517, PEP 660): the wheel is the folder rcbd and what pip wants to know of it, without anything
compiled; librcbd.so.1 is found at run time. It needs Python alone, so that no network is needed."""
import base64
import hashlib
import os
import re
import tarfile
import zipfile

HERE = os.path.dirname(os.path.abspath(__file__))
SOURCES = ("README.md", "rcbd_backend.py", "pyproject.toml")


def _text(*path):
    with open(os.path.join(HERE, *path), encoding="utf-8") as file:
        return file.read()


VERSION = re.search(r'^__version__ = "(.*)"$', _text("rcbd", "_library.py"), re.M).group(1)
DIST = f"rcbd-{VERSION}"


def _metadata():
    field = {name: re.search(rf'^{name} = "(.*)"$', _text("pyproject.toml"), re.M).group(1)
             for name in ("description", "requires-python")}
    depends = re.findall(r'"([^"]+)"', re.search(r"^dependencies = \[(.*)\]$", _text("pyproject.toml"), re.M).group(1))
    with_mpi = re.findall(r'"([^"]+)"', re.search(r"^mpi = \[(.*)\]$", _text("pyproject.toml"), re.M).group(1))
    lines = ["Metadata-Version: 2.1", "Name: rcbd", f"Version: {VERSION}", f"Summary: {field['description']}",
             f"Requires-Python: {field['requires-python']}", *(f"Requires-Dist: {one}" for one in depends),
             "Provides-Extra: mpi", *(f"Requires-Dist: {one}; extra == 'mpi'" for one in with_mpi),
             "Description-Content-Type: text/markdown", "", _text("README.md")]
    return "\n".join(lines)


def _package():
    return sorted(name for name in os.listdir(os.path.join(HERE, "rcbd")) if name.endswith((".py", ".typed")))


def _wheel(directory, files):
    """files: text by its path in the wheel, to which what pip wants to know is added."""
    info = DIST + ".dist-info"
    files = {**files, info + "/METADATA": _metadata(),
             info + "/WHEEL": "Wheel-Version: 1.0\nGenerator: rcbd\nRoot-Is-Purelib: true\nTag: py3-none-any\n"}
    record = []
    for path, text in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).rstrip(b"=").decode()
        record.append(f"{path},sha256={digest},{len(text.encode())}\n")
    files[info + "/RECORD"] = "".join(record) + info + "/RECORD,,\n"
    name = DIST + "-py3-none-any.whl"
    with zipfile.ZipFile(os.path.join(directory, name), "w", zipfile.ZIP_DEFLATED) as wheel:
        for path, text in files.items():
            entry = zipfile.ZipInfo(path, (1980, 1, 1, 0, 0, 0))  # the same wheel whenever it is built
            entry.external_attr = 0o644 << 16
            wheel.writestr(entry, text, zipfile.ZIP_DEFLATED)
    return name


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    return _wheel(wheel_directory, {"rcbd/" + name: _text("rcbd", name) for name in _package()})


def build_editable(wheel_directory, config_settings=None, metadata_directory=None):
    return _wheel(wheel_directory, {"rcbd.pth": HERE + "\n"})


def build_sdist(sdist_directory, config_settings=None):
    name = DIST + ".tar.gz"
    with tarfile.open(os.path.join(sdist_directory, name), "w:gz", format=tarfile.PAX_FORMAT) as sdist:
        for path in (*SOURCES, *("rcbd/" + one for one in _package())):
            sdist.add(os.path.join(HERE, path), f"{DIST}/{path}")
        info = os.path.join(sdist_directory, "PKG-INFO")
        with open(info, "w", encoding="utf-8") as file:
            file.write(_metadata())
        sdist.add(info, f"{DIST}/PKG-INFO")
        os.remove(info)
    return name
