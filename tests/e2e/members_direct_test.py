"""Members of a parallel solver that push straight to the ranks: the same scenes, reports and lists as by ids, whatever the
numbers of members and ranks; what breaks ends the step for all."""
import signal as signals
import time

import members_test
from member_client import DirectMember
from protocol_client import Client, Refused, arrays_of
from support import *

RANKS, PARTS, POINTS = 3, 7, 900
LISTS = ("changed_id", "changed_part")


class MembersDirect(ServiceTest):
    ranks = RANKS
    create, state, refused = members_test.Members.create, members_test.Members.state, members_test.Members.refused

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        rng = np.random.default_rng(11)
        points = rng.random((POINTS, 3)) * [2, 1, 1]
        cls.walk = [points]
        for step in range(1, 9):  # a slow crowding to one side, a jump, and rest
            points = points + rng.normal(0, 2e-3, points.shape) if step != 7 else points
            points = points * [0.97, 1, 1] if step != 5 else rng.random((POINTS, 3)) ** 2
            cls.walk.append(points)
        cls.control = Client(cls.path)
        cls.addClassCleanup(cls.control.close)

    def team(self, scene, members):
        team = [DirectMember(self.path, scene, k, members) for k in range(members)]
        for one in team:
            self.addCleanup(one.close)
        return team

    def blocks(self, members):
        return [np.arange(k * POINTS // members, (k + 1) * POINTS // members) for k in range(members)]

    def push_by_ids(self, team, step, held=None, attempt=0):
        held = held or [np.array(sorted(one.places)) for one in team]
        for one, ids in zip(team, held):
            one.start(step, ids, self.walk[step], attempt)
        return [one.finish() for one in team]

    def push_directly(self, team, step, attempt=0):
        for one in team:
            one.start_directly(step, self.walk[step], attempt)
        return [one.finish() for one in team]

    def begun(self, scene, members, parts=PARTS):
        """A team that has pushed step 0."""
        self.create(scene, parts)
        team = self.team(scene, members)
        self.push_by_ids(team, 0, self.blocks(members))
        return team

    def test_the_same_scenes_reports_and_lists_as_by_ids(self):
        for members in (RANKS, 2, 5, 1, 8):
            ids = self.begun("ids", members)
            direct = self.begun("direct", members)
            repartitions = drifted = 0
            for step in range(1, len(self.walk)):
                expected = self.push_by_ids(ids, step)
                got = self.push_directly(direct, step)
                for k, ((answer, lists), (same_answer, same_lists)) in enumerate(zip(got, expected)):
                    for name in LISTS:
                        np.testing.assert_array_equal(lists[name], same_lists[name], f"{name}, member {k}, step {step}")
                    self.assertEqual(direct[k].places, ids[k].places)
                    self.assertEqual(answer["plan"], same_answer["plan"])
                    self.assertEqual(answer["report"]["bytes"], 24 * POINTS)
                repartitions += got[0][0]["report"]["repartitioned"]
                drifted += got[0][0]["report"]["drifted"] > 0
                self.assertEqual(self.state("direct"), self.state("ids"), f"{members} members, step {step}")
                fetched = self.control.ask("fetch", scene="direct")[1]
                self.assertEqual(fetched, self.control.ask("fetch", scene="ids")[1])
            self.assertGreater(repartitions, 1)
            self.assertGreater(drifted, 4)
            for one in ids + direct:
                one.close()

    def test_members_that_have_not_moved(self):
        for members in (RANKS, 2, 5):
            ids, direct = self.begun("ids", members), self.begun("direct", members)
            points = self.walk[0]
            resting = ((), (0,), (1,), (0, 1), tuple(range(members)), (members - 1,))
            for step, still in enumerate(resting, 1):
                points = points.copy()
                moved = [i for k, one in enumerate(direct) if k not in still for i in one.places]
                points[moved] = points[moved] * [0.95, 1, 1]
                for one in ids:
                    one.start(step, np.array(sorted(one.places)), points)
                expected = [one.finish() for one in ids]
                for k, one in enumerate(direct):
                    if k in still:
                        one.begin_directly(step, points, moved="none")
                    else:
                        one.start_directly(step, points)
                for (answer, lists), (_, same_lists) in zip([one.finish() for one in direct], expected):
                    for name in LISTS:
                        np.testing.assert_array_equal(lists[name], same_lists[name])
                    self.assertEqual(answer["report"]["bytes"], 24 * len(moved))
                    self.assertEqual("motion" in answer["report"]["skipped"], not moved)
                for name in ("assign", "fetch"):
                    self.assertEqual(self.control.ask(name, scene="direct")[1], self.control.ask(name, scene="ids")[1])
                self.assertEqual(self.state("direct")[0], self.state("ids")[0])
            for one in ids + direct:
                one.close()

    def held(self, scene):
        """{id: point}"""
        answer, bulk = self.control.ask("fetch", scene=scene)
        got = arrays_of(answer, bulk)
        return dict(zip(got["id"].tolist(), np.stack([got[a] for a in "xyz"], 1).tolist()))

    def test_members_whose_particles_come_and_go(self):
        rng = np.random.default_rng(5)
        for members in (RANKS, 2, 5):
            team = self.begun("changes", members)
            points = np.concatenate([self.walk[0], np.zeros((2000, 3))])  # by id
            alive, newest = set(range(POINTS)), POINTS
            for step in range(1, 9):
                for k, one in enumerate(team):
                    mine = sorted(one.places)
                    few = None if (step + k) % 3 == 0 else set(rng.choice(mine, 9 * (k % 2), replace=False).tolist())
                    moving = mine if few is None else sorted(few)
                    points[moving] += rng.normal(0, 0.02, (len(moving), 3))
                    one.removed = rng.choice(mine, min(len(mine), 5 * (step % 2)), replace=False)
                    new = rng.random((k + step % 4, 3))
                    edits = {"removed": len(one.removed), "inserted": len(new),
                             "slices": int(len(one.removed) > 0) + int(len(new) > 0)}
                    one.begin_directly(step, points, few=few, **edits)
                    for link, data in one.slices(points):
                        link.sendall(data)
                    if len(one.removed):
                        one.edit("removed", {"id": one.removed})
                    if len(new):
                        one.edit("inserted", dict(zip("xyz", new.T)))
                    points[newest: newest + len(new)] = new  # the service chooses the ids, in the order of the members
                    one.new = list(range(newest, newest + len(new)))
                    newest += len(new)
                    alive = (alive - set(one.removed.tolist())) | set(one.new)
                for one in team:
                    answer, news = one.finish()
                    self.assertEqual(news.get("inserted_id", np.array([])).tolist(), one.new)
                    self.assertEqual(answer["places"], "changed")
                self.assertEqual(self.held("changes"), {i: points[i].tolist() for i in alive})
                self.assertEqual(sorted(i for one in team for i in one.places), sorted(alive))
            for one in team:
                one.close()

    def test_what_is_wrong_in_few_inserted_and_removed(self):
        team = self.begun("odd", 2)
        before = self.state("odd")
        points, mine = self.walk[0], sorted(team[0].places)
        attempt = 0

        def refuse(code, *words, few=frozenset(), slots={}, **edits):
            nonlocal attempt
            attempt += 1
            slices = {name: columns for name, columns in edits.items() if isinstance(columns, dict)}
            said = {name: len(next(iter(columns.values()))) for name, columns in slices.items()}
            more = {name: value for name, value in edits.items() if name not in slices}
            team[0].begin_directly(1, points, attempt=attempt, few=set(few), slices=len(slices), **said, **more)
            for rank, slot in slots.items():
                team[0].slots[rank][:] = slot
            for link, data in team[0].slices(points):
                link.sendall(data)
            for name, columns in slices.items():
                team[0].edit(name, columns)
            team[1].begin_directly(1, points, attempt=attempt, few=set())
            for one in team:
                self.refused(one, code, *words)
            self.assertEqual(self.state("odd"), before)

        some = {axis: np.array([0.5, 0.25]) for axis in "xyz"}
        refuse("not_found", "particle 5000", "removed", removed={"id": np.array([mine[0], 5000])})
        refuse("invalid_argument", "more than once", removed={"id": np.array([mine[0], mine[0]])})
        refuse("already_exists", "particle 3", inserted={**some, "id": np.array([7000, 3])}, inserted_ids=True)
        refuse("not_finite", "inserted particle 1", inserted={**some, "y": np.array([0.5, np.nan])})
        there = {rank: slot for rank, slot in team[1].places.values()}
        near = [i for i, (rank, _) in team[0].places.items() if rank in there]
        self.assertTrue(near, "no rank with particles of both members")
        refuse("stale_plan", "member 0", "slot", few=near[:1], slots=there)
        # One gives ids and the other doesn't: the second is refused alone, and does as the first.
        team[0].begin_directly(1, points, attempt=90, few=set(), inserted=2, inserted_ids=True, slices=1)
        self.control.ask("status")
        team[1].begin_directly(1, points, attempt=90, few=set(), inserted=2, slices=1)
        self.refused(team[1], "invalid_argument", "member 0")
        team[0].edit("inserted", {**some, "id": np.array([7000, 7001])})
        team[1].begin_directly(1, points, attempt=91, few=set(), inserted=2, inserted_ids=True, slices=1)
        team[1].edit("inserted", {**some, "id": np.array([8000, 6000])})
        for one, ids in zip(team, ([7000, 7001], [8000, 6000])):
            self.assertEqual(one.finish()[1]["inserted_id"].tolist(), ids)
        self.assertEqual(self.held("odd")[6000], [0.25, 0.25, 0.25])

    def test_a_member_that_is_killed_in_the_midst_of_its_slices(self):
        for members in (RANKS, 2, 5):
            team = self.begun("killed", members)
            before = self.state("killed")
            last = team[-1]
            child = os.fork()
            if child == 0:  # holds the member's sockets, once this process has closed its own
                try:
                    last.begin_directly(1, self.walk[1])
                    link, data = next(last.slices(self.walk[1]))
                    link.sendall(data[: len(data) // 2])
                    time.sleep(60)
                finally:
                    os._exit(1)
            for one in (last, *last.links):
                one.socket.close()
            for one in team[:-1]:
                one.start_directly(1, self.walk[1])
            time.sleep(0.2)
            os.kill(child, signals.SIGKILL)
            os.waitpid(child, 0)
            for one in team[:-1]:
                self.refused(one, "aborted", f"member {members - 1}")
            self.assertEqual(self.state("killed"), before)
            held = [np.array(sorted(one.places)) for one in team]
            team[-1] = DirectMember(self.path, "killed", members - 1, members)
            self.addCleanup(team[-1].close)
            # The others know their places still, the one that is new doesn't: all push by ids, once.
            team[0].start_directly(1, self.walk[1], attempt=1)
            self.control.ask("status")
            team[-1].start(1, held[-1], self.walk[1], attempt=1)
            self.refused(team[0], "stale_plan", f"member {members - 1}", "by ids")
            for one, ids in zip(team[:-1], held):
                one.start(1, ids, self.walk[1], attempt=2)
            for one in team:
                self.assertEqual(one.finish()[0]["report"]["step"], 1)
            self.assertEqual(self.push_directly(team, 2)[0][0]["report"]["step"], 2)
            for one in team:
                one.close()

    def test_a_plan_or_parts_that_are_stale(self):
        team = self.begun("stale", 5)
        self.push_directly(team, 1)
        # On one rank or another parts have changed now, perhaps no plan.
        self.control.ask("rebalance", scene="stale", method="bands-x")
        before = self.state("stale")
        for one in team:
            one.start_directly(2, self.walk[2])
            self.refused(one, "stale_plan")
        for one in team:
            plan = self.control.ask("scene.show", scene="stale")[0]["plan"]
            one.plan = plan
            one.start_directly(2, self.walk[2], attempt=1)
            self.refused(one, "stale_plan", "epoch")
        self.assertEqual(self.state("stale"), before)
        self.push_by_ids(team, 2, attempt=2)
        self.push_directly(team, 3)
        self.push_by_ids(team, 4)
        team[2].step = 3
        team[2].start_directly(5, self.walk[5])
        self.refused(team[2], "base_lost", "step 3")

    def test_what_is_wrong_in_a_slice_ends_the_step_for_all(self):
        team = self.begun("wrong", 4)
        before = self.state("wrong")

        def refuse_all(code, *words):
            for one in team:
                self.refused(one, code, *words)
            self.assertEqual(self.state("wrong"), before)

        bad = self.walk[1].copy()
        bad[123, 1] = np.nan
        for one in team:
            one.start_directly(1, bad)
        refuse_all("not_finite", "123")
        for one in team[:-1]:
            one.start_directly(1, self.walk[1], attempt=1)
        team[-1].begin_directly(1, self.walk[1], attempt=1)
        frames = list(team[-1].slices(self.walk[1]))
        frames[-1][0].sendall(frames[-1][1])  # not the first slots of its rank
        refuse_all("invalid_argument", "member 3", "slot")
        for one in team:
            one.begin_directly(1, self.walk[1], attempt=2, deadline_seconds=1 if one is team[0] else 20)
        for one in team[:2]:
            for link, data in one.slices(self.walk[1]):
                link.sendall(data)
        refuse_all("deadline_exceeded", "member 2", "member 3")
        self.push_directly(team, 1, attempt=3)

    def test_a_member_that_lost_its_answer(self):
        team = self.begun("again", 3)
        answers = self.push_directly(team, 1)
        team[1].step = 0  # as if it had not come
        team[1].start_directly(1, self.walk[1], attempt=1)
        answer, lists = team[1].finish()
        self.assertTrue(answer["repeated"])
        for name in LISTS:
            np.testing.assert_array_equal(lists[name], answers[1][1][name])
        self.push_directly(team, 2)

    def solve(self, service, processes, scene, path, *more, wait=True, steps=8):
        command = [MPIRUN, str(processes), os.path.join(BIN, "slope_mpi"), "--points", "1500", "--interval", "0.3",
                   "--parts", "6", "--tolerance", "0.02", "--steps", str(steps), "--scene", scene, "--json", *more]
        environment = dict(os.environ, RCBD_ENDPOINT=service.endpoint, RCBD_PATH=path)
        running = subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE, text=True)
        if not wait:
            return running
        out, errors = running.communicate(timeout=120)
        self.assertEqual(running.returncode, 0, out + errors)
        solved = json.loads(out)
        sizes = [report.pop("bytes") // 1500 for report in solved["reports"]]
        for report in solved["reports"]:
            report.pop("seconds"), report.pop("scene")
        ways = {"gateway": "endpoint", "auto": "endpoint", "direct": "sockets", "shared": "shared-memory"}
        self.assertEqual([report.pop("way") for report in solved["reports"]],
                         ["endpoint"] + [ways[path]] * (len(solved["reports"]) - 1))
        return solved, sizes

    def test_the_library_goes_to_the_ranks_by_itself(self):
        for processes in (RANKS, 2, 5):
            by_ids, sizes = self.solve(self.service, processes, "gateway", "gateway")
            self.assertEqual(sizes, [32] * 9)
            for path in ("direct", "shared"):
                direct, sizes = self.solve(self.service, processes, path, path, "--check")
                self.assertEqual(sizes, [32] + [24] * 8)  # ids came at the first step alone
                for name in ("reports", "held", "handed_over", "repartitions"):
                    self.assertEqual(direct[name], by_ids[name])
                self.assertGreater(direct["repartitions"], 1)
                self.assertEqual(self.state(path), self.state("gateway"))

    def test_the_library_pushes_by_ids_where_it_must(self):
        running = self.solve(self.service, 4, "shaken", "direct", wait=False, steps=60)
        rebalanced, next_step = 0, 0  # every few steps, so that members push straight to the ranks in between
        try:
            while running.poll() is None:
                try:
                    step = self.control.ask("scene.show", scene="shaken")[0]["step"]
                    if step is not None and step >= next_step:
                        self.control.ask("rebalance", scene="shaken", method=("bands-x", "rcb")[rebalanced % 2])
                        rebalanced, next_step = rebalanced + 1, step + 5
                except Refused as refused:
                    self.assertIn(refused.args[0], ("not_found", "busy"))
                time.sleep(0.02)
        finally:
            out, errors = running.communicate(timeout=120)
        self.assertEqual(running.returncode, 0, out + errors)
        sizes = [report["bytes"] // 1500 for report in json.loads(out)["reports"]]
        self.assertEqual(sum(json.loads(out)["held"]), 1500)
        self.assertGreater(rebalanced, 1)
        self.assertGreater(sizes[1:].count(32), 0)
        self.assertGreater(sizes.count(24), 0)
        os.environ["RCBD_GATEWAY_ONLY"] = "1"
        try:
            with Service(2) as service:
                self.assertEqual(self.solve(service, 2, "slope", "auto")[1], [32] * 9)
                running = self.solve(service, 2, "slope", "direct", wait=False)
                self.assertIn("--gateway-only", running.communicate(timeout=120)[1])
                self.assertEqual(running.returncode, 3)
        finally:
            del os.environ["RCBD_GATEWAY_ONLY"]


if __name__ == "__main__":
    unittest.main(verbosity=2)
