"""Point files as users have them: which columns are read, by every command that reads any, and in which order frames come."""
from protocol_client import Client, arrays_of
from support import *


class PointFiles(ServiceTest, Refusals):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        rng = np.random.default_rng(23)
        cls.points = rng.random((300, 2))
        cls.ids = rng.permutation(900)[:300]
        cls.weights = rng.random(300)
        cls.table = np.column_stack([cls.points[:, 1], cls.ids, cls.points[:, 0], cls.weights, rng.random(300)])
        cls.plain = os.path.join(cls.dir, "plain.csv")  # the reference: columns x, y, id, w
        np.savetxt(cls.plain, cls.table[:, [2, 0, 1, 3]], delimiter=",", header="x,y,id,w", comments="", fmt="%.17g")
        cls.named = os.path.join(cls.dir, "named.csv")
        np.savetxt(cls.named, cls.table, delimiter=",", header="B,tag,a,m,t[s]", comments="", fmt="%.17g")
        cls.numbered = cls.save("numbered.npy", cls.table)
        fields = np.zeros(300, dtype=np.dtype([("tag", "u1"), ("id", ">u4"), ("x", "<f8"), ("y", ">f8"), ("w", "<f8")],
                                              align=True))
        for field, column in (("id", cls.ids), ("x", cls.points[:, 0]), ("y", cls.points[:, 1]), ("w", cls.weights)):
            fields[field] = column
        cls.structured = cls.save("structured.npy", fields)
        # Each with the options by which it is the reference.
        cls.files = ((cls.plain, ("--weights", "w")), (cls.structured, ("--weights", "w")),
                     (cls.named, ("--columns", "A,b", "--ids", "tag", "--weights", "m")),
                     (cls.named, ("--columns", "2,0", "--ids", "1", "--weights", "3")),
                     (cls.numbered, ("--columns", "2,0", "--ids", "1", "--weights", "3")))

    def text(self, name, content):
        path = os.path.join(self.dir, name)
        write_text(path, content)
        return path

    def fetched(self, scene):
        with Client(self.service.endpoint[5:]) as client:
            return arrays_of(*client.ask("fetch", scene=scene))

    def assert_is_the_reference(self, scene, **what):
        arrays = self.fetched(scene)
        order = np.argsort(self.ids)
        for name, column in (("id", self.ids), ("x", self.points[:, 0]), ("y", self.points[:, 1]), ("w", self.weights)):
            np.testing.assert_array_equal(arrays[name], column[order], f"{what}: {name}")

    def test_every_command_takes_the_columns_that_are_asked_for(self):
        hashes, ghosts, parts = set(), set(), set()
        for file, options in self.files:
            for ranks in ((), ("--ranks", 2)):
                out = os.path.join(self.dir, "part.npy")
                args = ("partition", file, "--parts", 5, "--assign", out, *options, *ranks)
                hashes.add(self.service.json(*args)["hash"])
                parts.add(np.load(out).tobytes())
                compared = self.service.json("compare", file, "--parts", 5, *options, *ranks)
                ghosts.add(tuple(compared["methods"][0]["ghosts"]))
            self.service.json("replay", "r", file, "--parts", 5, "--replace", *options)
            self.assert_is_the_reference("r", file=file, options=options)
            self.service.json("scene", "create", "p", "--parts", 5, "--dims", 2, "--replace")
            self.service.json("push", "p", file, *options)
            self.assert_is_the_reference("p", file=file, options=options)
        self.assertEqual((len(hashes), len(ghosts), len(parts)), (1, 1, 1))

    def test_load_takes_them_too(self):
        with Service(2, cwd=self.dir) as service:
            client = Client(service.endpoint[5:])
            self.addCleanup(client.close)
            for file in (self.named, self.numbered):
                client.ask("scene.create", scene="l", parts=5, dims=2, replace=True)
                client.ask("load", scene="l", path=file, columns=["2", "0"], ids="1", weights="3")
                arrays = arrays_of(*client.ask("fetch", scene="l"))
                np.testing.assert_array_equal(arrays["id"], np.sort(self.ids))
                np.testing.assert_array_equal(arrays["x"], self.points[np.argsort(self.ids), 0])
            client.ask("scene.create", scene="l", parts=5, dims=2, replace=True)
            for wrong in ("2,0", ["0", "1", "2", "3"], [0, 1], ["2"], ["9", "0"]):
                self.refused("invalid_argument", client.ask, "load", scene="l", path=file, columns=wrong)
            # What a file is called tells nothing of what is in it.
            said = self.refused("invalid_argument", client.ask, "load", scene="l", path=self.named)
            self.assertNotIn("tag", said)
            empty = self.text("empty.csv", "x,y\n")
            self.assertIn("holds no points", self.refused("invalid_argument", client.ask, "load", scene="l", path=empty))

    def test_names_in_the_comment_of_savetxt(self):
        path = os.path.join(self.dir, "saved.txt")
        np.savetxt(path, self.table[:, [1, 2, 0, 3]], header="grains\nid x y w")
        for ranks in ((), ("--ranks", 2)):
            hashes = {self.service.json("partition", file, "--parts", 5, "--weights", "w", *ranks)["hash"]
                      for file in (path, self.plain)}
            self.assertEqual(len(hashes), 1)

    def test_doubtful_files_are_refused_alike(self):
        for name, content, says in (("rank.csv", "Rank,t[s],vx\n1,2,3\n", "named Rank, t[s], vx"),
                                    ("comment.txt", "# vx vy vz\n1 2 3\n", "named vx, vy, vz"),
                                    ("gap.csv", "x,y\n1,2\n#N/A,2\n3,4\n", "gap.csv:3: "),
                                    ("sep.csv", "sep=;\nx;y\n1;2\n", "sep="),
                                    ("xyz.xyz", "1\nProperties=pos:R:3\nH 1 2 3\n", "Properties")):
            path = self.text(name, content)
            for ranks in ((), ("--ranks", 2)):
                failure = self.service.failure("partition", path, "--parts", 2, *ranks)
                self.assertIn(says, failure["message"], (name, ranks))
        failure = self.service.failure("partition", self.save("wide.npy", self.points.T), "--parts", 2)
        self.assertIn("transpose", failure["hint"])
        self.assertNotIn("--dims", failure["hint"])

    def replayed(self, *numbers, name="step.{}.csv"):
        """The number of the last frame, and what was said."""
        files = []
        for number in numbers:
            path = os.path.join(self.dir, name.format(number))
            write_text(path, f"x\n{number}\n")
            files.append(path)
        done = self.service.ctl("replay", "order", *files, "--parts", 1, "--replace", "--json", check=True)
        self.assertEqual(json.loads(done.stdout)["steps"], len(files))
        return self.fetched("order")["x"][0], done.stderr

    def test_files_are_taken_in_the_order_of_their_numbers(self):
        last, said = self.replayed(0, 100, 20, 3)
        self.assertEqual(last, 100)
        self.assertIn("step.20.csv before ", said)
        self.assertEqual(self.replayed(0.5, 1.5, 1, 10, 2)[0], 10)
        self.assertEqual(self.replayed("007", "0100", "08")[0], 100)

    def test_an_order_that_no_shell_makes_stays(self):
        for numbers in ((3, 2, 1), (1, 5, 1), (5, 10, 2), (2, 10, 100), (0.05, 0.1, 0.15, 0.2)):
            self.assertEqual(self.replayed(*numbers), (numbers[-1], ""), numbers)


if __name__ == "__main__":
    unittest.main(verbosity=2)
