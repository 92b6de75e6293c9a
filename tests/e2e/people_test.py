"""What rcbctl prints for people: short numbers, many parts summed up, whole keys of cuts, what is amiss; and commands that
must not do what nobody asked for."""
import re
import time

from protocol_client import Client
from support import *


def long_numbers(text):
    """Those with a point and more than four digits that count."""
    found = re.findall(r"(?<![\w.])\d+\.\d+", text)
    return [number for number in found if len(number.replace(".", "").lstrip("0")) > 4]


class People(ServiceTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.rng = np.random.default_rng(11)
        cls.points = cls.rng.random((2000, 3))
        cls.file = cls.save("points.npy", cls.points)
        cls.walk = cls.save("walk.npy", cls.points + np.cumsum(cls.rng.normal(0, 0.004, (30, 2000, 3)), axis=0))
        for name, parts in (("few", 8), ("many", 100)):
            cls.service.json("replay", name, cls.walk, "--parts", parts, "--tolerance", "inf")
        grid = np.stack(np.meshgrid(*[np.arange(10.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
        cls.service.json("replay", "lattice", cls.save("lattice.npy", grid), "--parts", 7)

    def text(self, *args):
        done = self.service.ctl(*args)
        self.assertEqual((done.returncode, done.stderr), (0, ""), args)
        return done.stdout

    def shell(self, line, text=""):
        return subprocess.run(["bash", "-c", "set -o pipefail; " + line], input=text, capture_output=True, text=True, timeout=60,
                              env=dict(os.environ, RCBD_ENDPOINT=self.service.endpoint,
                                       PATH=BIN + ":" + os.environ["PATH"]))

    def test_numbers_are_short(self):
        """Those of cuts aside, which have the digits that tell the cuts of an axis apart."""
        for args in (("status",), ("stats", "few"), ("error", "few"), ("counts", "few"), ("quality", "few"), ("history", "few"), ("scene", "show", "few"), ("scene", "list"),
                     ("rebalance", "few", "--dry-run"), ("compare", self.file, "--parts", 8),
                     ("partition", self.file, "--parts", 8), ("push", "few", self.file)):
            text = re.sub(r"[0-9a-f]{16}", "", self.text(*args))
            self.assertEqual(long_numbers(text), [], (args, text))

    def test_many_parts_are_summed_up(self):
        counts = self.service.json("counts", "many")
        errors = [abs(c - t) / t for c, t in zip(counts["counts"], counts["targets"])]
        lines = self.text("counts", "many").splitlines()
        self.assertEqual([line.split()[0] for line in lines[1:4]], ["least", "median", "largest"])
        self.assertEqual([int(lines[k].split()[1]) for k in (1, 3)], [min(counts["counts"]), max(counts["counts"])])
        worst = [int(line.split()[0]) for line in lines[4:9]]
        self.assertEqual(worst, sorted(range(100), key=lambda p: (-errors[p], p))[:5])
        self.assertIn("--all", lines[9])
        self.assertEqual(len(lines), 10)
        self.assertEqual(len(self.text("counts", "many", "--all").splitlines()), 101)
        self.assertEqual(len(self.text("counts", "few").splitlines()), 9)
        self.assertLess(len(self.text("quality", "many").splitlines()), 16)
        self.assertGreater(len(self.text("quality", "many", "--all").splitlines()), 100)
        self.assertLess(len(self.text("cuts", "many").splitlines()), 40)
        self.assertGreater(len(self.text("cuts", "many", "--all").splitlines()), 199)
        self.assertLess(len(self.text("compare", self.file, "--parts", 100).splitlines()), 16)
        self.assertGreater(len(self.text("compare", self.file, "--parts", 100, "--all").splitlines()), 100)
        self.assertLess(len(self.text("partition", self.file, "--parts", 1000)), 1000)

    def test_a_cut_shows_its_whole_key(self):
        cuts = self.service.json("cuts", "lattice")["cuts"]
        text = self.text("cuts", "lattice")
        for cut in cuts:
            names = [f"{'xyz'[axis]} {at:g}" for axis, at in zip(cut["ties"]["axes"], cut["ties"]["at"])]
            key = ", ".join(names + [f"id {cut['ties']['id']}"])
            self.assertRegex(text, rf"(?m)^ *{cut['node']} +{'xyz'[cut['axis']]} +{cut['at']:g} +{key}")

    def test_coordinates_far_from_the_origin_are_told_apart(self):
        far = self.save("far.npy", 1e9 + self.rng.random((64, 1)))
        self.service.json("replay", "far", far, "--parts", 16)
        rows = [line.split()[2] for line in self.text("cuts", "far").splitlines()[3:18]]
        self.assertEqual(len(set(rows)), 15, rows)

    def test_status_and_stats_say_where_things_are(self):
        scene = next(s for s in self.service.json("status")["scenes"] if s["scene"] == "few")
        self.assertLessEqual({"error", "imbalance", "holders", "mean_step_seconds"}, scene.keys())
        deadline = time.monotonic() + 20
        status = self.service.json("status")
        while None in status["memory_bytes"] and time.monotonic() < deadline:  # until each rank has given a sign of life
            time.sleep(0.2)
            status = self.service.json("status")
        self.assertEqual(len(status["memory_bytes"]), 2)
        self.assertGreater(min(status["memory_bytes"]), 1 << 20)
        self.assertTrue(os.path.isfile(status["log"]))
        self.assertEqual(os.path.dirname(status["log"]), status["data_dir"])
        text = self.text("status")
        for word in ("memory", "MiB", status["log"], "error", "imbalance", "ms a step", "few"):
            self.assertIn(word, text)
        text = self.text("stats", "few")
        for word in ("time a step", "error", "imbalance", "memory", "open by", status["log"]):
            self.assertIn(word, text)

    def test_a_closed_pipe_is_no_failure(self):
        for command in ("history few", "history few --json", "counts many --all", "cuts many --all --json", "--help",
                        "completion bash", "scene list", f"partition {self.file} --parts 1999 --all"):
            done = self.shell(f"rcbctl {command} | head -c 20")
            self.assertIn(done.returncode, (0, 141), (command, done.stderr))
            self.assertEqual(done.stderr, "", command)
        self.assertEqual(self.shell("rcbctl history few > /dev/full").returncode, 1, "a full disk is one")
        for solver in ("two_spheres --points 200 --steps 1", "slope --points 200 --steps 1"):
            self.assertEqual(self.shell(f"{solver} --no-service --json > /dev/full").returncode, 1, solver)

    def test_where_output_cannot_go_is_told(self):
        os.mkfifo(f"{self.dir}/fifo.npy")
        os.symlink("nowhere", f"{self.dir}/dangling")
        for line, exit_code, told in (("status >&-", 1, "it is closed"), ("assign few --out -", 2, "one of this name is ./-"),
                                      (f"assign few --out {self.dir}/fifo.npy", 1, "nobody reads it"),
                                      (f"export few {self.dir}/dangling", 1, "is no directory")):
            done = self.shell("rcbctl " + line)
            self.assertEqual(done.returncode, exit_code, line + done.stderr)
            self.assertIn(told, done.stderr)
        self.assertFalse(os.path.exists("-"))
        done = self.shell(f"cat {self.dir}/fifo.npy | wc -c & sleep 0.3; rcbctl assign few --out {self.dir}/fifo.npy >&2; wait")
        self.assertEqual((done.returncode, int(done.stdout)), (0, 128 + 4 * 2000), done.stderr)

    def test_a_history_that_fails_is_no_whole_document(self):
        for line in ("history few --plot /nonexistent/x.svg --json", "history few --csv /dev/full --json"):
            done = self.shell("rcbctl " + line)
            self.assertEqual(done.returncode, 1, line)
            with self.assertRaises(json.JSONDecodeError, msg=done.stdout[:200]):
                json.loads(done.stdout)
        self.service.json("scene", "create", "unpushed", "--parts", 2)
        done = self.shell(f"rcbctl history unpushed --plot {self.dir}/x.svg --json")
        self.assertEqual(list(json.loads(done.stdout)), ["failure"])

    def test_watch_ends_with_its_reader(self):
        self.assertIn(self.shell("timeout 30 rcbctl watch few | true").returncode, (0, 141))

    def test_export_leaves_no_other_partitions_files(self):
        self.service.json("replay", "out", self.walk, "--parts", 12)
        folder = os.path.join(self.dir, "out")
        self.service.json("export", "out", folder)
        self.service.json("export", "out", folder)
        foreign = {"notes.txt", "part-a.csv", "part-3.csv.bak", "my-part-1.csv"}
        for name in foreign:
            write_text(os.path.join(folder, name), "mine\n")
        self.service.json("rebalance", "out", "--parts", 5)
        failure = self.service.failure("export", "out", folder)
        self.assertIn("part-00.csv", failure["message"])
        self.assertIn("--replace", failure["hint"])
        self.assertEqual(len(os.listdir(folder)), 12 + len(foreign), "refused before anything was written")
        self.service.json("export", "out", folder, "--replace")
        self.assertEqual(set(os.listdir(folder)), {f"part-{p}.csv" for p in range(5)} | foreign)
        self.service.failure("partition", self.file, "--parts", 3, "--out", folder)
        for ranks in ((), ("--ranks", 2)):
            self.service.json("partition", self.file, "--parts", 3, "--out", folder, "--replace", *ranks)
            self.assertEqual(set(os.listdir(folder)), {f"part-{p}.csv" for p in range(3)} | foreign)

    def test_files_of_others_are_not_overwritten(self):
        folder = os.path.join(self.dir, "mine")
        os.mkdir(folder)
        points = os.path.join(folder, "part-0.csv")
        np.savetxt(points, np.random.default_rng(1).random((40, 3)), "%.6f", ",")
        before = open(points).read()
        for name in ("same.csv", "same.json"):
            os.symlink(points, os.path.join(self.dir, name))
        for file in (points, os.path.join(self.dir, "same.csv")):
            failure = self.service.failure("partition", file, "--parts", 3, "--out", folder, "--replace")
            self.assertIn("would overwrite or remove the points", failure["message"])
            failure = self.service.failure("compare", file, "--parts", 3, "--save", os.path.join(self.dir, "same.json"))
            self.assertIn("would overwrite the points", failure["message"])
            failure = self.service.failure("replay", "over", file, file, "--history", file)
            self.assertIn("would overwrite the points", failure["message"])
            # With fewer parts it would be removed.
            os.rename(points, os.path.join(folder, "part-7.csv"))
            failure = self.service.failure("partition", os.path.join(folder, "part-7.csv"), "--parts", 3, "--out", folder,
                                           "--replace")
            self.assertIn("remove the points", failure["message"])
            os.rename(os.path.join(folder, "part-7.csv"), points)
        for one, other in (("both", "./both"), ("both", os.path.join(os.path.realpath(folder), "both"))):
            failure = self.service.failure("partition", points, "--parts", 3, "--assign", one, "--cuts", other, cwd=folder)
            self.assertIn("--assign and --cuts would write one file", failure["message"])
        self.assertEqual(open(points).read(), before)
        self.service.json("replay", "arrays", self.walk, "--parts", 2)
        array = os.path.join(folder, "positions.npy")
        np.save(array, np.zeros(3))
        failure = self.service.failure("export", "arrays", folder, "--format", "npy")
        self.assertIn("positions.npy", failure["message"])
        self.assertEqual(len(np.load(array)), 3)
        for replace in (["--replace"], []):  # then they are an export's
            self.service.json("export", "arrays", folder, "--format", "npy", *replace)
            self.assertNotEqual(len(np.load(array)), 3)

    def test_rows_with_ids_may_come_in_any_order(self):
        """By replay, too."""
        points, ids = self.rng.random((500, 3)), self.rng.permutation(500) + 1000
        files = []
        for k in range(3):
            order = self.rng.permutation(500)
            files.append(os.path.join(self.dir, f"shuffled-{k}.csv"))
            np.savetxt(files[-1], np.column_stack([ids, points])[order], "%d,%.17g,%.17g,%.17g", header="id,x,y,z",
                       comments="")
        self.service.json("replay", "ids", *files, "--parts", 4)
        for report in self.service.json("history", "ids")[1:]:
            self.assertIn(report["drifted"], (0, None))
            self.assertEqual(report["error"], report["error_before"])
        self.service.json("scene", "create", "rows", "--parts", 2)
        self.service.json("push", "rows", self.save("rows.npy", points))
        failure = self.service.failure("push", "rows", files[0])
        self.assertEqual(failure["code"], "not_conserved")

    def test_parts_are_told_by_row(self):
        """By `assign` as by `partition --assign`, whatever the order of a file's ids."""
        points, ids = self.rng.random((300, 3)), self.rng.permutation(300) + 1000
        def written(name, order, ids=None):
            columns = points if ids is None else np.column_stack([ids, points])
            path = os.path.join(self.dir, name)
            np.savetxt(path, columns[order], "%.17g", ",", header="x,y,z" if ids is None else "id,x,y,z", comments="")
            return path
        def parts(*words):
            out = os.path.join(self.dir, "parts.npy")
            done = self.service.json(*words, out)
            return np.load(out), done
        straight = np.arange(300)
        plain, own = written("plain.csv", straight), written("own.csv", straight, ids)
        other = written("other.csv", self.rng.permutation(300), ids)
        for name, file in (("by-row", plain), ("by-id", own)):
            self.service.json("scene", "create", name, "--parts", 7)
            self.service.json("push", name, file)
            self.service.json("replay", name + "-2", file, file, "--parts", 7)
        expected = parts("partition", plain, "--parts", 7, "--assign")[0]
        np.testing.assert_array_equal(parts("partition", own, "--parts", 7, "--assign")[0], expected)
        for name in ("by-row", "by-row-2"):
            array, told = parts("assign", name, "--out")
            self.assertEqual(told["order"], "rows")
            np.testing.assert_array_equal(array, expected)
        for name in ("by-id", "by-id-2"):
            array, told = parts("assign", name, "--out")
            self.assertEqual((told["order"], array.dtype), ("ids", np.int32))
            np.testing.assert_array_equal(array, expected[np.argsort(ids)])
            np.testing.assert_array_equal(parts("assign", name, own, "--out")[0], expected)
            np.testing.assert_array_equal(parts("assign", name, other, "--out")[0],
                                          parts("partition", other, "--parts", 7, "--assign")[0])
        self.assertIn("ids of its own", self.service.failure("assign", "by-id", plain, "--out", self.dir + "/x.npy")["message"])

    def test_an_export_without_particles_has_the_columns(self):
        file = os.path.join(self.dir, "four.csv")
        write_text(file, "x,y,z,w\n0,0,0,1\n1,0,0,2\n2,0,0,3\n3,0,0,4\n")
        self.service.json("scene", "create", "weighted", "--parts", 2)
        self.service.json("push", "weighted", file, "--weights", "w")
        with Client(self.path) as client:
            client.ask("push", scene="weighted", step=1, n=0, removed=4)
        folder = os.path.join(self.dir, "nobody")
        told = self.service.json("export", "weighted", folder, "--format", "csv,npy")
        self.assertEqual(sorted(os.path.basename(file) for file in told["files"]), sorted(os.listdir(folder)))
        self.assertEqual(text_of(folder, "part-0.csv"), "x,y,z,id,weight\n")
        self.assertEqual(np.load(os.path.join(folder, "weight.npy")).shape, (0,))

    def test_an_export_is_whole_or_not_there(self):
        folder = os.path.join(self.dir, "half")
        os.makedirs(os.path.join(folder, "part-5.csv"))  # the last files can't be written
        failure = self.service.failure("export", "few", folder)
        self.assertIn("part-5.csv: is a directory", failure["message"])
        self.assertEqual(os.listdir(folder), ["part-5.csv"])
        missing = os.path.join(self.dir, "not", "there")
        done = self.shell(f"ulimit -f 40; rcbctl export few {missing} --format csv,vtk")  # VTK's file is the largest
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertIn("few.vtk", done.stderr)
        self.assertFalse(os.path.exists(missing))

    def test_more_parts_than_points(self):
        for command in ("partition", "compare"):
            done = self.service.ctl(command, self.save("three.npy", self.points[:3]), "--parts", 5, check=True)
            self.assertEqual(done.stderr, "rcbctl: 5 parts for 3 points: some parts are empty\n")

    def test_a_box_without_bounds(self):
        regions = self.service.json("cuts", "few")["regions"]
        for region in regions:
            corners = [("-inf" if value is None else value) for value in region["lo"]]
            corners += [("inf" if value is None else value) for value in region["hi"]]
            self.assertIn(region["part"], self.service.json("box", "few", *corners)["parts"])
        inside = [0.5, 0.5]
        touched = set(self.service.json("box", "few", "-INF", *inside, "inf", *inside)["parts"])
        for x in np.linspace(0, 1, 9):
            self.assertLessEqual(set(self.service.json("box", "few", x, *inside, x, *inside)["parts"]), touched)
        self.assertEqual(set(self.service.json("box", "few", *["-inf"] * 3, *["inf"] * 3)["parts"]), set(range(8)))
        self.assertLess(touched, set(range(8)))
        self.assertIn("stands in the low corner", self.service.failure("box", "few", "inf", 0, 0, "inf", 1, 1)["hint"])
        self.assertIn("'-inf' is not a number", self.service.failure("owner", "few", "-inf", 0, 0)["message"])

    def test_what_json_cannot_hold_is_named(self):
        name = os.fsdecode(b"j\xe9t")
        for command in (["error", name], ["scene", "drop", name], ["push", name, self.file],
                        ["scene", "create", name, "--parts", 2], ["partition", self.file, "--parts", 2, "--weights", name]):
            done = subprocess.run([RCBCTL, *map(str, command), "--json"], capture_output=True, timeout=60,
                                  env=dict(os.environ, RCBD_ENDPOINT=self.service.endpoint))
            self.assertIn(done.returncode, (1, 2), command)
            self.assertRegex(done.stderr.decode(errors="replace"), r"(scene name|the \w+) ['\"]j.t['\"]|column 'j.+t'", command)
            self.assertNotIn(b"versions", done.stderr, command)
        file = os.path.join(os.fsencode(self.dir), b"f\xe9.npy")
        shutil.copyfile(self.file, file)
        for ranks in ([], ["--ranks", 2]):
            out = os.path.join(os.fsencode(self.dir), b"out\xe9" + str(len(ranks)).encode())
            subprocess.run([RCBCTL, "partition", file, "--parts", "2", "--out", out, *map(str, ranks)], check=True, timeout=60,
                           capture_output=True, env=dict(os.environ, RCBD_ENDPOINT=self.service.endpoint))
            self.assertEqual(sorted(os.listdir(out)), [b"part-0.csv", b"part-1.csv"])

    def test_long_questions_have_deadlines(self):
        """A service that stands still is left at the deadline."""
        ranks = self.service.processes("rcbd")
        for pid in ranks:
            os.kill(pid, signal.SIGSTOP)
        try:
            for command in (["assign", "few", "--out", self.dir + "/late.npy"], ["export", "few", self.dir + "/late"],
                            ["quality", "few"], ["rebalance", "few"]):
                self.assertEqual(self.service.failure(*command, "--deadline", "0.1")["exit"], 5, command)
        finally:
            for pid in ranks:
                os.kill(pid, signal.SIGCONT)

    def test_interface_areas_beyond_a_double(self):
        far = self.save("far.npy", (self.points - 0.5) * 2e154)
        self.service.json("replay", "outermost", far, "--parts", 8)
        quality = self.service.json("quality", "outermost")
        self.assertEqual(quality["interface_area"], sys.float_info.max)
        self.assertTrue(all(0 < area <= sys.float_info.max for area in quality["interface_areas"]))
        self.assertNotIn(" -", self.text("quality", "outermost"))

    def test_weights_that_count_as_nothing_are_told(self):
        weights = np.where(np.arange(200) % 4 == 0, 1e-30, 1e30)
        weights[7] = 0
        file = os.path.join(self.dir, "weights.csv")
        np.savetxt(file, np.column_stack([self.points[:200], weights]), "%.17g", ",", header="x,y,z,w", comments="")
        for words in (["partition", file, "--parts", 4, "--weights", "w"],
                      ["replay", "weights", file, "--parts", 4, "--weights", "w"]):
            done = self.service.ctl(*words, "--json", check=True)
            answer = json.loads(done.stdout)
            self.assertEqual(answer.get("last", answer)["weights_as_zero"], 50)
            self.assertIn("50 of the weights above 0 are so small beside the greatest that they count as 0", done.stderr)
        self.assertNotIn("weights_as_zero", self.service.json("history", "few")[0])

    def test_completion_of_fish(self):
        """Its descriptions have apostrophes."""
        script = self.text("completion", "fish")
        quoted = re.compile(r"(?:[^'\\]|\\.|'(?:[^'\\]|\\.)*')*")
        for line in script.splitlines():
            if not line.startswith("#"):
                self.assertEqual(quoted.match(line).end(), len(line), f"a quote isn't closed: {line}")
        if shutil.which("fish") is None:
            self.skipTest("fish is not installed: only its quotes were looked at")
        done = subprocess.run(["fish", "--no-config", "-c", 'rcbctl completion fish | source; complete -C "rcbctl st"'],
                              capture_output=True, text=True, timeout=60,
                              env=dict(os.environ, HOME=self.dir, PATH=BIN + ":" + os.environ["PATH"]))
        self.assertEqual(done.stderr, "")
        self.assertEqual([line.split("\t")[0] for line in done.stdout.splitlines()], ["stats", "status", "stream"])

    def test_columns_that_could_be_anything_are_refused(self):
        wide = self.save("wide.npy", self.rng.random((20, 4)))
        self.service.json("scene", "create", "wide", "--parts", 2)
        self.assertIn("4 columns", self.service.failure("push", "wide", wide)["message"])
        self.service.json("push", "wide", wide, "--dims", 3)
        self.service.json("scene", "create", "flat", "--parts", 2, "--dims", 2)
        failure = self.service.failure("push", "flat", self.file)
        self.assertIn("--dims 2", failure["hint"])

    def test_a_figure_of_three_scenes(self):
        figure = os.path.join(self.dir, "three.svg")
        self.service.json("history", "few", "--with", "many", "--with", "lattice", "--plot", figure)
        text = open(figure).read()
        for name in ("few", "many", "lattice"):
            self.assertIn(name, text)

    def test_replay_replaces_when_told_so(self):
        before = self.service.json("scene", "show", "few")
        failure = self.service.failure("replay", "few", self.walk, "--parts", 3)
        self.assertEqual(failure["code"], "already_exists")
        self.assertIn("--replace", failure["hint"])
        self.assertEqual(self.service.json("scene", "show", "few"), before)
        for _ in range(2):
            self.service.json("replay", "again", self.walk, "--parts", 3, "--replace")

    def test_a_first_push_has_particles(self):
        empty = os.path.join(self.dir, "empty.csv")
        open(empty, "w").close()
        self.service.json("scene", "create", "empty", "--parts", 2)
        for _ in range(2):
            failure = self.service.failure("push", "empty", empty)
            self.assertIn("holds no points", failure["message"])
        self.service.json("push", "empty", self.file)
        self.assertIn("holds no points", self.service.failure("replay", "nothing", empty)["message"])
        self.assertEqual(self.service.failure("scene", "show", "nothing")["code"], "not_found")

    def test_a_scene_without_particles_takes_any(self):
        client = Client(self.service.endpoint[5:])
        self.addCleanup(client.close)
        client.ask("scene.create", scene="none", parts=4, tolerance="inf")
        client.push("none", 0, np.zeros((0, 3)))
        report = self.service.json("push", "none", self.file, "--inserted", 2000)
        self.assertEqual((report["n"], report["error"], report["reason"]),
                         (2000, 0, "the scene had no particles before; new cuts leave 0"))
        self.service.json("replay", "some", self.file, "--parts", 4)
        for name in ("none", "some"):
            self.service.json("assign", name, "--out", os.path.join(self.dir, name + "-parts.npy"))
        np.testing.assert_array_equal(*(np.load(os.path.join(self.dir, name + "-parts.npy")) for name in ("none", "some")))
        self.assertEqual(self.service.json("push", "none", self.file)["n"], 2000)

    def test_a_frozen_rank_is_told_first(self):
        victim = max(pid for pid, line in processes_of(self.service.dir) if line.split()[0].endswith("/rcbd"))
        os.kill(victim, signal.SIGSTOP)
        try:
            deadline = time.monotonic() + 20
            text = self.text("status")
            while "silent" not in text and time.monotonic() < deadline:
                time.sleep(0.2)
                text = self.text("status")
            self.assertRegex(text.splitlines()[0], r"^rank 1 silent for \d+ s$")
            self.assertRegex(text, r"(?m)^ranks +2, of which 1 silent$")
            self.assertEqual(self.service.json("status")["silent"][0]["rank"], 1)
        finally:
            os.kill(victim, signal.SIGCONT)

    def test_a_mistyped_scene_is_told_as_what_it_is(self):
        failure = self.service.failure("error", "fwe")
        self.assertEqual(failure["message"], "no scene 'fwe'")
        self.assertRegex(failure["hint"], r"^did you mean few\? there are: .*lattice, many")
        self.assertRegex(self.service.failure("watch", "many2")["hint"], r"did you mean many\?")
        self.assertIn("no scene", self.service.failure("history", "many2", "--first", 0)["message"])
        self.assertNotIn("mean", self.service.failure("stats", "zzzzzz")["hint"])

    def test_completion_knows_scenes(self):
        def completed(line):
            done = self.shell('source <(rcbctl completion bash); COMP_LINE=$(cat); COMP_LINE=${COMP_LINE%.}; '
                              'COMP_POINT=${#COMP_LINE}; _rcbctl; echo "${COMPREPLY[@]}"', text=line + ".")
            self.assertEqual(done.stderr, "")
            return done.stdout.split()

        self.assertEqual(completed("rcbctl counts fe"), ["few"])
        self.assertIn("lattice", completed("rcbctl history "))
        self.assertEqual(completed("rcbctl counts --al"), ["--all"])
        self.assertNotIn("few", completed("rcbctl push few "))
        self.assertEqual(completed("rcbctl stat"), ["status", "stats"])
        self.assertEqual(completed("rcbctl scene sh"), ["show"])
        self.assertEqual(completed("rcbctl --json counts fe"), ["few"])  # a flag has no value
        self.assertIn("--parts", completed("rcbctl scene create --replace --par"))
        self.assertEqual(completed("rcbctl scene show fe"), ["few"])
        self.assertEqual(completed("rcbctl partition --parts "), [])
        self.assertEqual(completed(f"rcbctl --endpoint {self.service.endpoint} counts fe"), ["few"])
        self.assertEqual(completed("rcbctl --endpoint unix:/nonexistent counts fe"), [])
        nowhere = self.shell("export RCBD_ENDPOINT=unix:/nonexistent; rcbctl completion scenes")
        self.assertEqual((nowhere.returncode, nowhere.stdout, nowhere.stderr), (0, "", ""))


if __name__ == "__main__":
    unittest.main(verbosity=2)
