"""halo, neighbours and box --periodic against NumPy by the definition: i (of part p) is in the halo of q if for some whole
multiples s of the periods, y = x + s, the distance max(lo_q - y, y - hi_q, 0) is at most H; q = p only with s other than 0."""
import csv
import itertools

from protocol_client import Client
from support import *

INF = np.inf


def shifts(periodic, width):
    """Every whole number of periods that may matter, for points within a period of the box."""
    most = [0 if lo is None else int(width / (hi - lo)) + 3 for lo, hi in zip(*periodic)]
    return itertools.product(*[range(-m, m + 1) for m in most])


def near(lo, hi, regions, shift, width, norm, periodic):
    """By box [lo, hi] moved by the shift (a point: lo = hi), and region: whether they are within the width."""
    gaps = []
    for a, k in enumerate(shift):
        p, q = periodic[0][a], periodic[1][a]
        by = 0.0 if p is None else k * (q - p)
        low, high = regions[0][:, a], regions[1][:, a]
        if p is not None:  # where a region has no bound, the box's
            low, high = np.where(low == -INF, p, low), np.where(high == INF, q, high)
        with np.errstate(invalid="ignore"):  # an empty region ends at infinity, too; NaN is near nothing
            gaps.append(np.maximum(np.maximum(low - (hi[:, None, a] + by), (lo[:, None, a] + by) - high), 0.0))
    if norm == "max":
        return np.max(gaps, axis=0) <= width
    return sum(gap * gap for gap in gaps) <= width * width


def halo(points, ids, part, regions, width, norm, periodic):
    """All entries (from, id, to, shift), sorted."""
    entries = []
    for shift in shifts(periodic, width):
        found = near(points, points, regions, shift, width, norm, periodic)
        if not any(shift):
            found[np.arange(len(points)), part] = False
        entries += [(part[i], ids[i], q, shift) for i, q in np.argwhere(found)]
    return sorted(entries)


def neighbours(regions, width, norm, periodic):
    lo, hi = regions[0].copy(), regions[1].copy()
    for a in range(lo.shape[1]):
        if periodic[0][a] is not None:
            lo[:, a] = np.where(lo[:, a] == -INF, periodic[0][a], lo[:, a])
            hi[:, a] = np.where(hi[:, a] == INF, periodic[1][a], hi[:, a])
    lists = [[] for _ in lo]
    for shift in shifts(periodic, width):
        found = near(lo, hi, regions, shift, width, norm, periodic)
        if not any(shift):
            np.fill_diagonal(found, False)
        for p, q in np.argwhere(found):
            lists[p].append((q, shift))
    return [sorted(own) for own in lists]


def words(periodic):
    """--periodic on the command line; nothing where no axis is."""
    bounds = ["-" if b is None else repr(b) for corner in periodic for b in corner]
    return ["--periodic", *bounds] if set(bounds) != {"-"} else []


class Scene:
    """What a service says of the cuts and parts of a scene."""

    def __init__(self, service, name, points, ids, folder):
        self.name, self.points, self.ids = name, points, ids
        service.ctl("assign", name, "--out", os.path.join(folder, "part.npy"), check=True)
        self.part = np.load(os.path.join(folder, "part.npy"))[np.argsort(np.argsort(ids))]
        listed = service.json("cuts", name)["regions"]
        bound = lambda values, missing: [missing if v is None else v for v in values]
        self.regions = (np.array([bound(r["lo"], INF if r.get("empty") else -INF) for r in listed]),
                        np.array([bound(r["hi"], -INF if r.get("empty") else INF) for r in listed]))

    def halo(self, *question):
        return halo(self.points, self.ids, self.part, self.regions, *question)


def make_scene(service, name, points, parts, folder, ids=None):
    """Pushed as a file, with ids where some are given."""
    path = os.path.join(folder, name + ".csv")
    columns = {axis: points[:, a] for a, axis in enumerate("xyz"[: points.shape[1]])} | ({} if ids is None else {"id": ids})
    with open(path, "w") as file:
        print(",".join(columns), file=file)
        for row in zip(*columns.values()):
            print(",".join(map(repr, map(lambda v: v.item(), row))), file=file)
    service.ctl("scene", "create", name, "--parts", parts, "--dims", points.shape[1], check=True)
    service.ctl("push", name, path, check=True)
    return Scene(service, name, points, np.arange(len(points)) if ids is None else ids, folder)


def questions(dims):
    """(width, norm, periodic): widths of 0, small and beyond half a box; every subset of the axes."""
    for axes in itertools.product([False, True], repeat=dims):
        periodic = ([0.0 if on else None for on in axes], [1.0 if on else None for on in axes])
        for width, norm in ((0.0, "max"), (0.03, "euclid"), (0.6, "max"), (0.6, "euclid")):
            yield width, norm, periodic


class Halo(ServiceTest):
    ranks = 3

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        rng = np.random.default_rng(7)
        lattice = np.stack(np.meshgrid(*[np.arange(4) / 4] * 2, indexing="ij"), -1).reshape(-1, 2)
        ids = rng.permutation(10_000)[:60]
        sets = {"cube": (rng.random((60, 3)), 7, None), "named": (rng.random((60, 3)), 5, ids),
                "lattice": (np.concatenate([lattice, lattice]), 8, None), "line": (rng.random((40, 1)), 6, None),
                "beyond": (rng.random((50, 2)) * 3 - 1, 4, None), "few": (rng.random((3, 2)), 6, None)}
        cls.scenes = {name: make_scene(cls.service, name, points, parts, cls.dir, ids)
                      for name, (points, parts, ids) in sets.items()}

    def test_halo(self):
        for scene in self.scenes.values():
            for width, norm, periodic in questions(scene.points.shape[1]):
                with self.subTest(scene=scene.name, width=width, norm=norm, periodic=periodic):
                    out = tempfile.mkdtemp(dir=self.dir)
                    document = self.service.json("halo", scene.name, "--width", width, "--norm", norm, *words(periodic),
                                                 "--out", out)
                    expected = scene.halo(width, norm, periodic)
                    self.assertEqual(document["entries"], len(expected))
                    counts = {}
                    for source, _, to, _ in expected:
                        counts[source, to] = counts.get((source, to), 0) + 1
                    self.assertEqual([(pair["from"], pair["to"], pair["count"]) for pair in document["pairs"]],
                                     [(*pair, count) for pair, count in sorted(counts.items())])
                    self.assertEqual(self.written(out, scene), expected)

    def written(self, folder, scene):
        """The entries of all files, part by part."""
        parts, entries = len(scene.regions[0]), []
        self.assertEqual(sorted(os.listdir(folder)), sorted(f"halo_{p}.csv" for p in range(parts)))
        for p in range(parts):
            with open(os.path.join(folder, f"halo_{p}.csv")) as file:
                head, *rows = csv.reader(file)
            self.assertEqual(head, ["id", "to", "shift_x", "shift_y", "shift_z"][: 2 + scene.points.shape[1]])
            entries += [(p, int(row[0]), int(row[1]), tuple(map(int, row[2:]))) for row in rows]
        return entries

    def test_neighbours(self):
        for scene in self.scenes.values():
            for width, norm, periodic in questions(scene.points.shape[1]):
                with self.subTest(scene=scene.name, width=width, norm=norm, periodic=periodic):
                    document = self.service.json("neighbours", scene.name, "--width", width, "--norm", norm,
                                                 *words(periodic))
                    self.assertEqual([[(n["part"], tuple(n["shift"])) for n in own] for own in document["neighbours"]],
                                     neighbours(scene.regions, width, norm, periodic))

    def test_box(self):
        rng = np.random.default_rng(8)
        for scene in (self.scenes["cube"], self.scenes["lattice"], self.scenes["line"]):
            dims = scene.points.shape[1]
            for _, _, periodic in questions(dims):
                lo = rng.integers(-4, 5, dims) / 4
                hi = lo + rng.integers(0, 3, dims) / 4
                touched = np.zeros(len(scene.regions[0]), bool)
                for shift in shifts(periodic, 2):
                    touched |= near(lo[None], hi[None], scene.regions, shift, 0.0, "max", periodic)[0]
                answer = self.service.json("box", scene.name, *map(repr, lo.tolist()), *map(repr, hi.tolist()),
                                           *words(periodic))
                self.assertEqual(answer["parts"], np.flatnonzero(touched).tolist(), (scene.name, lo, hi, periodic))

    def test_documents_say_what_was_asked(self):
        document = self.service.json("halo", "cube", "--width", "1e-1", "--periodic", "-.5", 0, "-", "1.5", 1, "-")
        cuts = self.service.json("cuts", "cube")
        self.assertEqual((document["epoch"], document["hash"], document["width"], document["norm"], document["periodic"]),
                         (cuts["epoch"], cuts["hash"], 0.1, "max", {"lo": [-0.5, 0, None], "hi": [1.5, 1, None]}))
        self.assertIsNone(self.service.json("neighbours", "cube", "--width", 0)["periodic"])
        narrowest = self.service.json("quality", "lattice")["narrowest_region"]
        lo, hi = (corner[narrowest["part"]][narrowest["axis"]] for corner in self.scenes["lattice"].regions)
        self.assertEqual(narrowest["width"], hi - lo)
        self.assertEqual(self.service.json("cuts", "lattice")["narrowest_region"], narrowest)
        for command in ("quality", "cuts"):
            said = self.service.ctl(command, "lattice", check=True).stdout
            self.assertIn(f"narrowest region: part {narrowest['part']}, {narrowest['width']:.4g} along "
                          f"{'xyz'[narrowest['axis']]}", said)

    def test_tables(self):
        expected = self.scenes["cube"].halo(0.2, "max", ([None] * 3, [None] * 3))
        said = self.service.ctl("halo", "cube", "--width", 0.2, check=True).stdout
        pairs = sorted({(source, to) for source, _, to, _ in expected})
        rows = [tuple(map(int, line.split())) for line in said.splitlines()[1:] if line.strip()[:1].isdigit()
                and len(line.split()) == 3]
        self.assertEqual([row[:2] for row in rows], pairs)
        self.assertEqual(sum(row[2] for row in rows), len(expected))
        self.assertIn(f"{len(pairs)} pairs of parts, {len(expected)} points to send", said)
        said = self.service.ctl("neighbours", "line", "--width", 0, "--periodic", 0, 1, check=True).stdout
        self.assertRegex(said, r"(?m)^ +0 +2 +1 5\(1\)$")
        make_scene(self.service, "many", np.random.default_rng(9).random((500, 3)), 100, self.dir)
        for command in ("halo", "neighbours"):
            few = self.service.ctl(command, "many", "--width", 0.1, check=True).stdout
            self.assertLess(len(few.splitlines()), 16)
            everything = self.service.ctl(command, "many", "--width", 0.1, "--all", check=True).stdout
            self.assertGreater(len(everything.splitlines()), 99)

    def test_wrong_questions(self):
        usage = [("--width", "-0.1"), ("--width", "nan"), ("--width", "inf"), ("--width", "wide"), (),
                 ("--width", 1, "--norm", "manhattan"), ("--width", 1, "--periodic", 0, 0, 0, 1, 1),
                 ("--width", 1, "--periodic", 0, "-", 0, 1, 1, 1), ("--width", 1, "--periodic", 0, 0, "inf", 1, 1, 1),
                 ("--width", 1, "--periodic", 0, 0, "y", 1, 1, 1)]
        refused = [("--periodic", 0, 0, 1, 1), ("--periodic", 0, 0, 0, 1, 1, 0), ("--periodic", 0, 0, 2, 1, 1, 1),
                   ("--periodic", "-1.7e308", 0, 0, "1.7e308", 1, 1)]
        for command in ("halo", "neighbours"):
            for arguments in usage:
                failure = self.service.failure(command, "cube", *arguments)
                self.assertEqual((failure["code"], failure["exit"]), ("usage", 2), arguments)
            for arguments in refused:
                failure = self.service.failure(command, "cube", "--width", 1, *arguments)
                self.assertEqual((failure["code"], failure["exit"]), ("invalid_argument", 1), arguments)
            self.assertEqual(self.service.failure(command, "nobody", "--width", 1)["code"], "not_found")
            wide = self.service.failure(command, "cube", "--width", 1e9, "--periodic", 0, 0, 0, 1, 1, 1)
            self.assertEqual((wide["code"], wide["hint"]), ("too_large", "give a smaller width"))
        for arguments in refused:
            self.assertEqual(self.service.failure("box", "cube", *[0] * 6, *arguments)["code"], "invalid_argument")
        self.assertEqual(self.service.failure("box", "cube", *[0] * 6, "--periodic", 0, 1, 1)["code"], "usage")

    def test_places_that_cant_be_written(self):
        arguments = ("halo", "cube", "--width", 0.1, "--out")
        file = os.path.join(self.dir, "a_file")
        write_text(file, "mine\n")
        for place in (file, "/proc/halo", os.path.join(file, "below")):
            self.assertEqual(self.service.failure(*arguments, place)["code"], "io_error")
        self.assertEqual(text_of(file), "mine\n")
        there = os.path.join(self.dir, "there")
        os.makedirs(os.path.join(there, "halo_3.csv"))  # has the name of a file that is to be written
        self.assertEqual(self.service.failure(*arguments, there)["code"], "io_error")
        self.assertEqual(os.listdir(there), ["halo_3.csv"], "none of the others is left")
        os.rmdir(os.path.join(there, "halo_3.csv"))
        for name, ours in (("halo_7.csv", False), ("halo_07.csv", True), ("halo_x.csv", True)):
            write_text(os.path.join(there, name), "")
            if ours:
                self.service.json(*arguments, there)
            else:
                self.assertEqual(self.service.failure(*arguments, there)["code"], "already_exists")
                self.assertEqual(os.listdir(there), [name])
            os.remove(os.path.join(there, name))
        self.service.json(*arguments, there)  # what an answer before has left is replaced
        made = os.path.join(self.dir, "new", "folders")
        self.assertEqual(len(self.service.json(*arguments, made)["files"]), 7)


class AnyRanks(unittest.TestCase):
    def test_the_same_answers(self):
        points = np.random.default_rng(3).random((400, 3))
        box = {"lo": [0, None, 0], "hi": [1, None, 1]}
        answers = []
        for ranks in (1, 3, 8):
            with Service(ranks) as service, Client(service.endpoint[5:]) as client:
                client.ask("scene.create", scene="s", parts=13)
                client.push("s", 0, points)
                answers.append([client.ask(command, scene="s", width=0.2, periodic=periodic, **more)
                                for periodic in (None, box)
                                for command, more in (("halo", {}), ("halo", {"lists": True, "norm": "euclid"}),
                                                      ("neighbours", {}))])
        self.assertEqual(answers[0], answers[1])
        self.assertEqual(answers[0], answers[2])
        arrays = {array["name"]: (array["dtype"], array["shape"]) for array in answers[0][4][0]["arrays"]}
        entries = answers[0][4][0]["entries"]
        self.assertEqual({name: arrays[name] for name in ("id", "list_from", "list_to", "shift")},
                         {"id": ("<i8", [entries]), "list_from": ("<i4", [entries]), "list_to": ("<i4", [entries]),
                          "shift": ("<i4", [entries, 3])})
        self.assertEqual((arrays["from"][0], arrays["to"][0], arrays["count"][0]), ("<i4", "<i4", "<i8"))


if __name__ == "__main__":
    unittest.main(verbosity=2)
