"""Seats of a parallel solver that join, push, die in the midst of a slice and come back."""
import numpy as np
from actor import Actor
from seat_client import Seat, owner
from model import Model, Told, check_report, check_scene
from protocol_client import Refused
from push_client import WAYS
from pushers import UNTRUE

TURNS = 25  # then another team


class Seats(Actor):
    expects = "a step is everybody's or nobody's; who died comes back with a higher generation; the scene is the model's"

    def start(self):
        self.control = self.connect()
        self.drop_all(self.control)
        rng = self.rng
        self.count_of_seats, self.parts = int(rng.integers(1, 6)), int(rng.integers(1, 12))
        self.model = Model.random(rng, int(rng.choice([40, 900, 3000])), int(rng.integers(1, 4)), False, False)
        self.scene = self.create(self.control, parts=self.parts, dims=self.model.points.shape[1],
                                 tolerance=float(rng.choice([0.02, 0.1])))
        self.number, self.turns, self.told = 0, 0, Told()
        n, count = len(self.model.ids), self.count_of_seats
        self.held = np.array_split(np.arange(n), count)
        self.team = [self.join(k) for k in range(count)]
        self.push()

    def join(self, seat, **options):
        return self.connect(Seat, self.scene, seat, self.count_of_seats, **options)

    def turn(self):
        self.turns += 1
        if self.turns > TURNS:
            self.close_all()
            return self.start()
        scale = float(self.rng.choice([1e-3, 0.02, 0.3]))
        self.model.points = self.model.points * self.rng.choice([1, 0.98]) + self.rng.normal(
            0, scale, self.model.points.shape)
        self.number += 1
        happens = self.rng.integers(8)
        if happens == 0:
            self.die()
        elif happens == 1:
            self.take_seat()
        elif happens == 2 and self.lie():
            self.close_all()
            return self.start()
        self.push()
        if self.turns % 6 == 0:
            check_scene(self, self.control, self.scene, self.model, self.told)
            self.count("checks")

    def begin_push(self, one, rows, deadline_seconds=None, **more):
        one.begin(self.number, rows, self.model.points, deadline_seconds=deadline_seconds or self.world.answer_seconds,
                  each=200, **{"cuts_known": self.told.known, "way": str(self.rng.choice(WAYS)), **more})

    def push(self):
        """One step of all, again as long as the service is busy."""
        for _ in range(100):
            for one, ids in zip(self.team, self.held):
                self.begin_push(one, ids)
                one.rest()
            refusals, answers = self.answers(self.team)
            if not refusals:
                return self.take(answers)
            self.expect(all(code in ("busy", "aborted") for code, _ in refusals), "a step of all seats", refusals)
            self.count("busy")
        self.expect(False, "busy a hundred times", refusals)

    def answers(self, team):
        refusals, answers = [], []
        for one in team:
            try:
                answers.append(one.finish())
            except Refused as refused:
                refusals.append(refused.args)
        return refusals, answers

    def take(self, answers):
        self.count("steps")
        for answer, _ in answers:
            check_report(self, answer["report"], self.scene, self.number, len(self.model.ids))
            self.expect(answer["report"] == answers[0][0]["report"], "reports of seats", answers)
        self.told.take(*answers[0])
        if self.rng.integers(2):  # what has left is handed over, or not
            owners = owner(self.told.tree.assign(self.model.points), self.parts, self.count_of_seats)
            self.held = [np.flatnonzero(owners == k) for k in range(self.count_of_seats)]

    def die(self):
        """A seat dies, between two steps or in one, and comes back."""
        victim = int(self.rng.integers(self.count_of_seats))
        one = self.team[victim]
        generation = one.opened["seat"]["generation"]
        if self.rng.integers(2) and len(self.held[victim]):  # else its begin would be the whole of its push
            self.die_in_a_step(victim)
        one.close()
        self.count("deaths")
        self.team[victim] = self.join(victim)
        now = self.team[victim].opened["seat"]["generation"]
        self.expect(now > generation, "generation", now, "after", generation)

    def die_in_a_step(self, victim):
        """The others are told, and the previous step stands."""
        before = self.ask(self.control, "scene.show", scene=self.scene)[0]["step"]
        others = [one for k, one in enumerate(self.team) if k != victim]
        for k, one in enumerate(self.team):
            if k != victim:
                self.begin_push(one, self.held[k])
                one.rest()
        one = self.team[victim]
        self.begin_push(one, self.held[victim], way="endpoint", cut=int(self.rng.integers(1, 25)))
        one.close()
        refusals, answers = self.answers(others)
        self.expect(not answers, "a step without seat", victim, answers[:1])
        self.expect(all(code in ("aborted", "busy") for code, _ in refusals), "seats of one that died", refusals)
        after = self.ask(self.control, "scene.show", scene=self.scene)[0]["step"]
        self.expect(before == after, "a step that was given up counts", before, after)

    def lie(self):
        """One seat's begin says one thing that isn't so. True if the step was committed all the same. The liar's
        connections are of no use then: ranks wait for what it says of its slices."""
        before = self.ask(self.control, "scene.show", scene=self.scene)[0]["step"]
        k = self.random.randrange(self.count_of_seats)
        for seat, (one, ids) in enumerate(zip(self.team, self.held)):
            try:
                self.begin_push(one, ids, deadline_seconds=2 * self.world.patience, **(self.lie_of() if seat == k else {}))
                one.rest()
            except TimeoutError:
                self.expect(seat == k, "a rank doesn't read what an honest seat sends")
        refusals, answers = self.answers(self.team)
        self.team[k].close()
        self.team[k] = self.join(k)
        self.count("lies")
        self.expect(all(code != "internal" for code, _ in refusals), self.said, refusals)
        if answers or any("it goes on" in text for _, text in refusals):  # past its deadline, and then committed perhaps
            return True
        after = self.ask(self.control, "scene.show", scene=self.scene)[0]["step"]
        self.expect(before == after, "a step that was refused counts", self.said, refusals, before, after)
        return False

    def lie_of(self):
        """One field of a push, and what isn't so."""
        fields = ("step", "attempt", "n", "way", "dtype", "weights", "ids", "counts", "memory", "sockets", "inserted", "removed",
                  "step_seconds", "cuts_known", "drifted", "incarnation")
        self.said = (self.random.choice(fields), self.random.choice(UNTRUE))
        return dict([self.said])

    def take_seat(self):
        """A seat comes back before its older connection has ended."""
        victim = int(self.rng.integers(self.count_of_seats))
        old = self.team[victim]
        generation = old.opened["seat"]["generation"]
        new = self.join(victim, generation=generation + 1)
        self.expect(new.opened["seat"]["generation"] == generation + 1, "generation", new.opened["seat"])
        old.close()
        self.team[victim] = new
        self.count("seats taken")
