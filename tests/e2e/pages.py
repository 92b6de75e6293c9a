"""The fenced blocks of all pages. A block says its language, and whoever tests a page runs or compiles it. A comment on the
line before it may say otherwise:

  <!-- not run: needs Slurm -->            why not
  <!-- run by: tests/e2e/x_test.py -->     this test takes it from the page, by blocks_for()
  <!-- part of: client/examples/x.cpp -->  it stands there, word for word, and that is built
  <!-- within: tests/e2e/snippets/x.c -->  compiled and run in the place of the line SNIPPET of this file
"""
import collections
import re

from support import *

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
MARKS = ("not run", "run by", "part of", "within")

# words: what follows the language, such as the standard (```cpp c++20).
Block = collections.namedtuple("Block", "page line language words text mark value")


def pages():
    found = []
    for folder, folders, names in os.walk(ROOT):
        folders[:] = sorted(name for name in folders if not name.startswith((".", "build")))
        found += [os.path.relpath(os.path.join(folder, name), ROOT) for name in sorted(names) if name.endswith(".md")]
    return found


def blocks(page):
    found, begun, before = [], None, ""
    for number, line in enumerate(text_of(ROOT, page).splitlines(), 1):
        fence = re.fullmatch(r"\s*```(.*)", line)
        if fence and begun is None:
            language, *words = fence[1].split() or [""]
            mark = re.fullmatch(r"\s*<!-- ([a-z ]+): (.+) -->\s*", before)
            begun, text = Block(page, number, language, words, "", *(mark.groups() if mark else ("", ""))), []
        elif fence:
            found.append(begun._replace(text="".join(one + "\n" for one in text)))
            begun = None
        elif begun is not None:
            text.append(line)
        before = line
    if begun is not None:
        raise AssertionError(f"{page}:{begun.line}: a block without an end")
    return found


def blocks_for(test):
    """Those that this test (its __file__) is to run."""
    name = os.path.relpath(os.path.abspath(test), ROOT)
    return [one for page in pages() for one in blocks(page) if (one.mark, one.value) == ("run by", name)]


def commands(text):
    """(machine or "", command) of each line with a prompt: `$ ls`, `a$ ls`; lines that end in a backslash go on."""
    return [(machine, command.replace("\\\n", " ")) for machine, command in
            re.findall(r"^(\w*)\$ ((?:.*\\\n)*.*)$", text, re.M)]
