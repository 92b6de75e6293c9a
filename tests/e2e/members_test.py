"""Parallel solvers: M members push a scene together, wait for one another, die and return."""
import threading

from member_client import Member, handed_over, owner
from protocol_client import NOTICE, Client, Refused
from support import *


class Members(ServiceTest):
    ranks = 3

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        rng = np.random.default_rng(7)
        cls.walk = rng.random((5, 600, 3)).cumsum(axis=0) * [1, 2, 1]
        cls.walk[2] = cls.walk[1] + rng.normal(0, 1e-2, cls.walk[0].shape)
        cls.walk[3] = cls.walk[2] + rng.normal(0, 1e-2, cls.walk[0].shape)
        cls.control = Client(cls.path)
        cls.addClassCleanup(cls.control.close)

    def create(self, scene, parts=7):
        self.control.ask("scene.create", scene=scene, parts=parts, replace=True)

    def team(self, scene, members, **kwargs):
        team = [Member(self.path, scene, k, members, **kwargs) for k in range(members)]
        for one in team:
            self.addCleanup(one.close)
        return team

    def state(self, scene):
        shown = self.control.ask("scene.show", scene=scene)[0]
        history = self.control.ask("history", scene=scene)[0]["history"]
        for report in history:
            for name in ("seconds", "scene", "bytes", "way"):
                report.pop(name)
        kept = {name: shown[name] for name in ("hash", "counts", "error", "plan", "step", "epoch", "ids")}
        return kept, history, self.control.ask("assign", scene=scene)[1]

    def refused(self, client, code, *words):
        with self.assertRaises(Refused) as caught:
            client.finish()
        self.assertEqual(caught.exception.args[0], code, caught.exception.args)
        for word in words:
            self.assertIn(word, caught.exception.args[1])

    def push_all(self, team, step, shares, points, **more):
        for one, ids in zip(team, shares):
            one.start(step, ids, points, **more)
        return [one.finish() for one in team]

    def test_the_same_scene_as_from_one_client(self):
        self.create("one")
        for step, points in enumerate(self.walk):
            self.control.push("one", step, points)
        for members in (1, 2, 3, 5):
            self.create("many")
            team = self.team("many", members)
            rng = np.random.default_rng(members)
            known = np.full(len(self.walk[0]), -1)
            for step, points in enumerate(self.walk):  # any split, in any order, a new one every time
                order = rng.permutation(len(points))
                shares = np.split(order, np.sort(rng.integers(0, len(points) + 1, members - 1)))
                for (answer, arrays), ids in zip(self.push_all(team, step, shares, points), shares):
                    self.assertEqual(answer["report"]["step"], step)
                    self.assertTrue(np.isin(arrays["changed_id"], ids).all())
                    known[arrays["changed_id"]] = arrays["changed_part"]
            state = self.state("many")
            self.assertEqual(state, self.state("one"))
            self.assertEqual(known.tobytes(), np.frombuffer(state[2][8 * len(known):], "<i4").astype(known.dtype).tobytes())
            for one in team:
                one.close()

    def test_members_follow_their_parts(self):
        parts = 7
        for members in (1, 2, 3, 5):
            self.create("follow", parts)
            team = self.team("follow", members, follow=True)
            n = len(self.walk[0])
            held = [np.arange(k * n // members, (k + 1) * n // members) for k in range(members)]
            for step, points in enumerate(self.walk):
                if step == 3:
                    self.control.ask("rebalance", scene="follow", method="bands-x")
                answers = self.push_all(team, step, held, points)
                _, bulk = self.control.ask("assign", scene="follow")
                of_id = owner(np.frombuffer(bulk[8 * n:], "<i4"), parts, members)
                for ids, (_, news) in zip(held, answers):
                    self.assertTrue((np.diff(news["changed_id"]) > 0).all())
                    self.assertTrue(np.isin(news["changed_id"], ids).all())
                kept = [np.flatnonzero(of_id == k) for k in range(members)]
                if step != 3:  # what the rebalance moved is told to nobody
                    for ids, expected in zip(handed_over(held, answers), kept):
                        np.testing.assert_array_equal(np.sort(ids), expected)
                held = kept
            for one in team:
                one.close()

    def test_own_ids_and_weights_and_empty_members(self):
        ids = np.array([5, 900, 7, 2**62, 11])
        points = np.random.default_rng(1).random((5, 2))
        self.control.ask("scene.create", scene="sparse", parts=2, dims=2, replace=True)
        team = self.team("sparse", 3, follow=True)
        for step in range(2):
            for k, one in enumerate(team):
                rows = [[0, 3], [], [4, 1, 2]][k]
                one.begin(step, rows, weights=bool(rows))  # who has none need not know
                if rows:
                    arrays = [{"name": name, "dtype": dtype, "shape": [len(rows)]}
                              for name, dtype in (("x", "<f8"), ("y", "<f8"), ("w", "<f8"), ("id", "<i8"))]
                    bulk = np.ascontiguousarray(points[rows].T).tobytes() + (ids[rows] % 3 + 1.0).tobytes()
                    one.send({"command": "push.slice", **one.push_id, "rank": 0, "count": len(rows),
                              "arrays": arrays}, bulk + ids[rows].astype("<i8").tobytes())
            for one in team:
                self.assertEqual(one.finish()[0]["report"]["n"], 5)
        shown = self.control.ask("scene.show", scene="sparse")[0]
        self.assertTrue(shown["ids"] and shown["weights"])

    def test_seats(self):
        self.create("seats")

        def refuses(code, *words, **kwargs):
            with self.assertRaises(Refused) as caught:
                Member(self.path, "seats", **kwargs)
            self.assertEqual(caught.exception.args[0], code, caught.exception.args)
            for word in words:
                self.assertIn(word, caught.exception.args[1])

        team = self.team("seats", 2)
        self.assertEqual(team[1].opened["membership"], {"member": 1, "members": 2, "generation": 1, "follow": False})
        refuses("busy", "member 1", "generation 1", member=1, members=2)
        refuses("invalid_argument", "members of 2", member=1, members=3)
        refuses("invalid_argument", "follow", member=1, members=2, follow=True)
        refuses("invalid_argument", "member", member=2, members=2)
        refuses("busy", "generation", member=1, members=2, generation=1)
        with self.assertRaises(Refused) as caught:
            team[0].ask("scene.open", scene="seats", member=0, members=2, generation=9)
        self.assertEqual(caught.exception.args[0], "invalid_argument")
        with self.assertRaises(Refused) as caught:  # others may look, not push
            self.control.push("seats", 0, self.walk[0])
        self.assertEqual(caught.exception.args[0], "busy")
        self.assertIn("2 members", caught.exception.args[1])
        with self.assertRaises(Refused) as caught:
            self.control.ask("load", scene="seats", path=self.save("theirs.npy", self.walk[0]))
        self.assertEqual(caught.exception.args[0], "busy")
        self.assertIn("2 members", caught.exception.args[1])
        for one in team:
            one.ask("scene.close", scene="seats")
        third = Member(self.path, "seats", 2, 3)
        third.ask("scene.close", scene="seats")  # a connection's end is noticed in its own time
        third.close()
        self.create("seats")

    def test_a_member_that_never_pushes(self):
        self.create("late")
        team = self.team("late", 4)
        halves = np.array_split(np.arange(600), 4)
        for k in (0, 3):
            team[k].start(0, halves[k], self.walk[0], deadline_seconds=1)
        team[1].begin(0, halves[1], deadline_seconds=9)  # and this one no slice
        for k in (0, 1, 3):
            self.refused(team[k], "deadline_exceeded", "member 1", "member 2", "step 0")
        self.push_all(team, 0, halves, self.walk[0], attempt=1)
        self.assertEqual(self.state("late")[0]["step"], 0)

    def test_a_step_that_is_another_than_that_of_the_others(self):
        halves = np.array_split(np.arange(600), 2)
        self.create("hasty")
        team = self.team("hasty", 2)
        team[0].start(0, halves[0], self.walk[0])
        begun = team[0].begun
        team[0].start(1, halves[0], self.walk[1])  # which is refused, and ends nothing
        self.refused(team[0], "invalid_argument", "the others push step 0")
        team[0].begun = begun
        team[1].start(0, halves[1], self.walk[0])
        for one in team:
            self.assertEqual(one.finish()[0]["report"]["step"], 0)

    def test_a_step_beyond_its_deadline_goes_on(self):
        with Service(2) as service:
            control = Client(service.endpoint[5:])
            self.addCleanup(control.close)
            control.ask("scene.create", scene="slow", parts=2)
            team = [Member(service.endpoint[5:], "slow", k, 2) for k in range(2)]
            for one in team:
                self.addCleanup(one.close)
            halves = np.array_split(np.arange(600), 2)
            first = control.ask("status")[0]["pid"]
            other, = [pid for pid, line in processes_of(service.dir)
                      if line.split()[0].endswith("/rcbd") and pid != first]
            os.kill(other, signal.SIGSTOP)  # the engine waits for it in the step's first collective
            try:
                for one, ids in zip(team, halves):
                    one.start(0, ids, self.walk[0], deadline_seconds=1)
                for one in team:
                    self.refused(one, "deadline_exceeded", "step 0", "it goes on")
            finally:
                os.kill(other, signal.SIGCONT)
            for answer, _ in self.push_all(team, 0, halves, self.walk[0], attempt=1):
                self.assertEqual(answer["report"]["step"], 0)
            self.assertEqual(control.ask("scene.show", scene="slow")[0]["step"], 0)
            self.push_all(team, 1, halves, self.walk[1])

    def test_waiting_members_are_told_for_whom(self):
        self.create("told")
        team = self.team("told", 2)
        team[0].start(0, np.arange(300), self.walk[0])
        kind, request, document, _ = team[0].receive()  # after five seconds
        self.assertEqual((kind, request), (NOTICE, team[0].begun))
        self.assertIn("member 1", document["notice"])
        team[1].start(0, np.arange(300, 600), self.walk[0])
        self.assertEqual(team[0].finish()[0]["report"]["step"], 0)
        team[1].finish()

    def test_a_member_that_dies_in_mid_push_and_returns(self):
        self.create("dies")
        halves = np.array_split(np.arange(600), 3)
        team = self.team("dies", 3)
        self.push_all(team, 0, halves, self.walk[0])
        before = self.state("dies")
        for cut in (None, 1, 5000):  # nothing of it, all but a byte, half
            for k in (0, 1):
                team[k].start(1, halves[k], self.walk[1])
            if cut:
                team[2].begin(1, halves[2])
                team[2].slice(halves[2], self.walk[1], cut)
            generation = team[2].opened["membership"]["generation"]
            team[2].close()
            for k in (0, 1):
                self.refused(team[k], "aborted", "member 2", "connection")
            self.assertEqual(self.state("dies"), before)
            team[2] = Member(self.path, "dies", 2, 3)
            self.addCleanup(team[2].close)
            self.assertEqual(team[2].opened["membership"]["generation"], generation + 1)
        self.push_all(team, 1, halves, self.walk[1], attempt=9)
        # Away between two steps: the others wait for the return.
        team[2].close()
        for k in (0, 1):
            team[k].start(2, halves[k], self.walk[2])
        team[2] = Member(self.path, "dies", 2, 3)
        self.addCleanup(team[2].close)
        team[2].start(2, halves[2], self.walk[2])
        for one in team:
            self.assertEqual(one.finish()[0]["report"]["step"], 2)

    def test_slices_of_an_older_generation_are_dropped(self):
        self.create("older")
        halves = np.array_split(np.arange(600), 2)
        team = self.team("older", 2)
        old = team[1]
        team[0].start(0, halves[0], self.walk[0])
        old.begin(0, halves[1])
        new = Member(self.path, "older", 1, 2, generation=2)
        self.addCleanup(new.close)
        self.refused(team[0], "aborted", "member 1", "generation 2")
        self.refused(old, "aborted", "member 1")
        team[0].start(0, halves[0], self.walk[0], attempt=1)
        old.slice(halves[1], self.walk[0] + 5)  # too late: read and dropped
        old.start(0, halves[1], self.walk[0] + 5, attempt=1)
        self.refused(old, "aborted", "generation")
        new.start(0, halves[1], self.walk[0])
        self.assertEqual(team[0].finish()[0]["report"]["n"], 600)
        new.finish()
        fetched = self.control.ask("fetch", scene="older")[1]
        np.testing.assert_array_equal(np.frombuffer(fetched[4800:9600], "<f8"), self.walk[0][:, 0])

    def test_a_lost_answer_is_given_again(self):
        self.create("again")
        halves = np.array_split(np.arange(600), 2)
        team = self.team("again", 2, follow=True)
        answers = self.push_all(team, 0, halves, self.walk[0])
        team[1].close()
        back = Member(self.path, "again", 1, 2, follow=True, session=team[1].session)
        self.addCleanup(back.close)
        back.start(0, halves[1], self.walk[0], attempt=5)
        answer, arrays = back.finish()
        self.assertTrue(answer["repeated"])
        self.assertEqual(answer["report"], answers[1][0]["report"])
        for name, values in answers[1][1].items():
            np.testing.assert_array_equal(arrays[name], values)
        stranger = Member(self.path, "again", 1, 2, follow=True, generation=7)
        self.addCleanup(stranger.close)
        stranger.start(0, halves[1], self.walk[0])
        self.refused(stranger, "stale_step", "0")

    def test_no_answer_is_given_again_after_a_later_step(self):
        self.create("later")
        halves = np.array_split(np.arange(600), 2)
        team = self.team("later", 2)
        self.push_all(team, 0, halves, self.walk[0])
        for one in team:
            one.close()
        wait_for(lambda: "e2e" not in self.control.ask("scene.show", scene="later")[0]["members"])
        self.control.push("later", 1, self.walk[1])  # the members had no part in it
        back = Member(self.path, "later", 1, 2, session=team[1].session)
        self.addCleanup(back.close)
        back.start(0, halves[1], self.walk[0], attempt=5)
        self.refused(back, "stale_step", "step 0")

    def test_what_members_push_wrong(self):
        self.create("wrong")
        team = self.team("wrong", 2)
        ids = np.arange(600)

        def both(code, words, first, second, points=self.walk[0], step=0):
            for one, mine in zip(team, (first, second)):
                one.start(step, mine, points)
            for one in team:
                self.refused(one, code, *words)

        both("invalid_argument", ("id 299", "member 0", "member 1"), ids[:300], ids[299:])
        both("invalid_argument", ("id 5", "twice", "member 1"), ids[:5], np.append(ids[5:], 5))
        bad = self.walk[0].copy()
        bad[17, 1] = np.nan
        both("not_finite", ("17",), ids[:300], ids[300:], bad)
        self.push_all(team, 0, (ids[:300], ids[300:]), self.walk[0])
        before = self.state("wrong")
        both("invalid_argument", ("id 300", "no member"), ids[:300], ids[301:], step=1)
        both("invalid_argument", ("id 599", "no member"), ids[:300], ids[300:599], step=1)
        more = np.concatenate([self.walk[0], self.walk[0]])
        both("invalid_argument", ("id 700", "member 1"), ids[:300], np.append(ids[300:], 700), more, step=1)
        team[0].begin(1, ids[:300])
        # What it sends next must be its slice: a change of the scene would keep that waiting.
        with self.assertRaises(Refused) as caught:
            team[0].ask("rebalance", scene="wrong")
        self.assertEqual(caught.exception.args[0], "busy")
        self.control.ask("status")
        team[1].begin(2, ids[300:])
        self.refused(team[1], "invalid_argument", "step 2", "step 1")
        team[1].begin(1, ids[300:], step_seconds=-1)
        self.refused(team[1], "invalid_argument", "step_seconds")
        team[1].begin(1, ids[300:], weights=True)
        self.refused(team[1], "invalid_argument", "weights")
        self.assertEqual(self.state("wrong"), before)
        team[0].slice(ids[:300], self.walk[1])
        team[1].start(1, ids[300:], self.walk[1])
        for one in team:
            self.assertEqual(one.finish()[0]["report"]["step"], 1)

    def test_a_rebalance_between_members_does_not_stop_them(self):
        self.create("between")
        halves = np.array_split(np.arange(600), 2)
        team = self.team("between", 2)
        self.push_all(team, 0, halves, self.walk[0])
        team[0].start(1, halves[0], self.walk[1])
        with Client(self.path) as other:
            self.control.ask("status")
            done = threading.Thread(target=other.ask, args=("rebalance",), kwargs={"scene": "between"})
            done.start()
            self.control.ask("status")
            team[1].start(1, halves[1], self.walk[1])
            for one in team:
                self.assertEqual(one.finish()[0]["report"]["step"], 1)
            done.join()


if __name__ == "__main__":
    unittest.main(verbosity=2)
