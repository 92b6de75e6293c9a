"""What goes wrong in steps that seats count together: one dies at any point of a step for whose positions a question waits;
the scene is made anew while they are away. The others are told, and the step is made once."""
import threading

from seat_client import Seat
from protocol_client import Client, Refused
from seats_client import Seats
from support import *

POINTS = np.random.default_rng(4).random((200, 3))
HALVES = [np.arange(k, 200, 2) for k in range(2)]


class CountFaults(ServiceTest, Refusals):
    ranks = 3

    def seats(self, scene):
        seats = Seats(self.path, scene, 2, "when-needed", np.random.default_rng(1), ("endpoint",), scene_options={"parts": 4})
        self.addCleanup(seats.close)
        self.assertEqual([seats.step(number, POINTS)[1] for number in range(2)], [True, False])
        return seats

    def back(self, seats, k):
        """Seat k, whose connection has ended."""
        last = seats.team[k]
        seats.team[k] = Seat(self.path, seats.scene, k, 2, session=last.session,
                               generation=last.opened["seat"]["generation"] + 1)
        seats.team[k].attempts = last.attempts
        return seats.team[k]

    def question(self, scene):
        """Waits for positions. (its thread, which step's it was answered)"""
        answered = []

        def ask():
            with Client(self.path) as client:
                answered.append(client.ask("assign", scene=scene)[0]["positions_step"])

        thread = threading.Thread(target=ask, daemon=True)
        thread.start()
        return thread, answered

    def die_before_its_count(self, seats, step):
        seats.start_count(seats.team[0], step, HALVES[0], POINTS, deadline_seconds=2)
        seats.team[1].close()
        return seats.team[0].answer

    def die_before_its_block(self, seats, step):
        seats.team[1].close()
        seats.team[0].start(step, HALVES[0], POINTS, deadline_seconds=2)
        return seats.team[0].finish

    def die_in_its_block(self, seats, step):
        seats.team[0].start(step, HALVES[0], POINTS, deadline_seconds=2)
        seats.team[1].begin(step, HALVES[1], POINTS, cut=100)
        seats.team[1].close()
        return seats.team[0].finish

    def test_a_seat_dies_while_a_question_waits(self):
        for die in (self.die_before_its_count, self.die_before_its_block, self.die_in_its_block):
            with self.subTest(die.__name__):
                seats = self.seats(die.__name__)
                thread, answered = self.question(seats.scene)
                step = 2
                while "send" not in (answer := seats.count(step, HALVES, POINTS)):
                    step += 1
                self.assertEqual(answer, {"send": "a question about positions waits"})
                with self.assertRaises(Refused) as refused:
                    die(seats, step)()
                code, message = refused.exception.args
                self.assertIn(code, ("aborted", "deadline_exceeded"))  # as the end is noticed in the step, or before it
                self.assertIn("seat 1", message)
                self.back(seats, 1)
                self.assertEqual(answered, [])
                self.assertTrue(seats.send(step, HALVES, POINTS)["report"]["sent"])
                thread.join(60)
                self.assertEqual(answered, [step])
                history = seats.control.ask("history", scene=seats.scene)[0]["history"]
                self.assertEqual([report["step"] for report in history], list(range(step + 1)))

    def test_a_scene_is_made_anew_while_its_seats_are_away(self):
        seats = self.seats("anew")
        for one in seats.team:
            one.close()

        def made_anew():
            seats.control.ask("scene.create", scene="anew", replace=True, parts=4, positions="when-needed")
            return True

        awaited(made_anew, 20, (Refused,))
        for k, ids in enumerate(HALVES):
            one = self.back(seats, k)
            self.assertEqual((one.opened["step"], one.opened["incarnation"] == seats.incarnation), (None, False))
            seats.start_count(one, 2, ids, POINTS)
            self.assertIn("made anew", self.refused("not_found", one.answer))
            one.start(2, ids, POINTS, incarnation=seats.incarnation)
            self.assertIn("made anew", self.refused("not_found", one.finish))
        self.assertEqual(seats.send(0, HALVES, POINTS)["report"]["reason"], "first positions")


if __name__ == "__main__":
    unittest.main(verbosity=2)
