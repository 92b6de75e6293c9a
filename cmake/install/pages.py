"""Man pages and completions from what the programs say: python3 pages.py FOLDER RCBCTL RCBD. The help texts are
the only source: a page for each program and each command, with the help's sections."""
import gzip
import os
import re
import shutil
import subprocess
import sys

ENVIRONMENT = {k: v for k, v in os.environ.items() if not k.startswith(("RCBD_", "XDG_RUNTIME"))}
VERBATIM = ("Examples",)
NO_COMMANDS = ("Options", "Arguments", "Environment", *VERBATIM)


def said(*words):
    return subprocess.run(words, env=ENVIRONMENT, capture_output=True, text=True, check=True).stdout


def roff(text):
    """Text that roff takes as it is."""
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return "\\&" + text if text.startswith((".", "'")) else text


def sections(text):
    """(what the help says first, its usage, {section: [lines]}); a paragraph after the sections has the section ""."""
    described, usage, found, name = [], "", {}, None
    for line in text.splitlines():
        if line.startswith("Usage: "):
            usage, name = line[len("Usage: "):], ""
        elif name is None:
            described.append(line)
        elif re.fullmatch(r"\S.*:", line):
            name = line[:-1]
        elif line and not line.startswith(" "):
            found.setdefault("", []).append(line)
            name = ""
        elif line and name:
            found.setdefault(name, []).append(line[2:])
    return " ".join(filter(None, described)), usage, found


def body(lines):
    """Entries, a name and what it means, as the help has them in two columns."""
    second = min((len(line) - len(line.lstrip()) for line in lines if line.startswith("   ")), default=26)
    for line in lines:
        if line.startswith("   "):
            yield roff(line.strip())
            continue
        name, _, text = line.partition("  ")
        if not text and line[second - 1:second] == " ":  # a name that leaves one space
            name, text = line[:second - 1], line[second:]
        yield from (".TP", f".B {roff(name)}", *([roff(text.strip())] if text else []))


def page(title, text, version):
    described, usage, found = sections(text)
    summary = found.pop("", [])
    out = [f'.TH {title.upper()} 1 "" "rcbd {version}" "rcbd"', ".SH NAME", f"{title} \\- {roff(described.removeprefix(title + ', '))}", ".SH SYNOPSIS",
           f".B {roff(usage)}"]
    for name, lines in found.items():
        out.append(f".SH {roff(name.upper())}")
        out += [".nf", *map(roff, lines), ".fi"] if name in VERBATIM else body(lines)
    if summary:
        out += [".SH NOTES", *map(roff, summary)]
    return "\n".join([*out, ".SH SEE ALSO", "rcbctl(1), rcbd(1)"]) + "\n"


def write_pages(folder, version, title, *words):
    text = said(*words, "--help")
    text = text.replace(f"rcbd-{os.getuid()}/", "rcbd-UID/")  # who builds isn't who reads
    with open(os.path.join(folder, title + ".1.gz"), "wb") as file:
        file.write(gzip.compress(page(title, text, version).encode(), mtime=0))
    commands = [line.split()[0] for name, lines in sections(text)[2].items() if name and name not in NO_COMMANDS
                for line in lines if re.match(r"[a-z]", line)]
    if words[0].endswith("rcbctl"):
        for command in commands:
            write_pages(folder, version, f"{title}-{command}", *words, command)


def main(folder, rcbctl, rcbd):
    shutil.rmtree(folder, ignore_errors=True)
    pages = os.path.join(folder, "man1")
    os.makedirs(pages)
    version = said(rcbctl, "--version").split()[-1]
    write_pages(pages, version, "rcbctl", rcbctl)
    write_pages(pages, version, "rcbd", rcbd)
    for shell, name in (("bash", "rcbctl"), ("zsh", "_rcbctl"), ("fish", "rcbctl.fish")):
        with open(os.path.join(folder, name), "w", encoding="utf-8") as file:
            file.write(said(rcbctl, "completion", shell))


main(*sys.argv[1:])
