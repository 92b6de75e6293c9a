"""One history, whoever tells it: by 1, 2, 4 and 7 seats, sent in each step or counted, to 1 to 8 ranks. hosts_test.py has the
same over several machines."""
import judge
from seats_client import FIELDS, history
from support import *

SEED = 20260
SEATS, PARTS, TOLERANCE = (1, 2, 4, 7), 7, 0.1


def on_a_grid(seed):
    """Many particles are in one place, so that ids decide."""
    rng = np.random.default_rng(seed)
    return np.round((rng.random((300, 2)) + rng.normal([0.01, 0], 0.01, (25, 300, 2)).cumsum(axis=0)) * 6) / 6


class OneHistory(unittest.TestCase):
    def test_one_history(self):
        trajectories = {"grid": on_a_grid(SEED)}
        with tempfile.TemporaryDirectory() as folder:
            file = os.path.join(folder, "t.npy")
            run("--points", 300, "--steps", 200, "--no-service", "--trajectory", file, program=os.path.join(BIN, "two_spheres"),
                check=True)
            trajectories["spheres"] = np.load(file)[80::3]
        expected = {}
        for ranks in range(1, 9):
            with Service(ranks) as service:
                for name, path in trajectories.items():
                    for seats in SEATS:
                        for positions in ("every-step", "when-needed"):
                            with self.subTest(name, ranks=ranks, seats=seats, positions=positions, seed=SEED):
                                told, sent = history(path, service.endpoint, name, seats, positions,
                                                     np.random.default_rng([SEED, ranks, seats]),
                                                     ("endpoint", "sockets", "shared-memory"),
                                                     scene_options={"parts": PARTS, "tolerance": TOLERANCE, "dims": path.shape[2]})
                                self.assertEqual(told, expected.setdefault(name, told))
                                new_cuts = sum(step[FIELDS.index("repartitioned")] for step in told)
                                self.assertEqual(sent, len(path) if positions == "every-step" else new_cuts)
        for name, path in trajectories.items():
            for told, predicted in zip(expected[name], judge.reports(path, PARTS, 1, TOLERANCE), strict=True):
                for field, value in zip(FIELDS, told):
                    if field in predicted:
                        self.assertEqual(value, predicted[field], (name, predicted["step"], field))
            repartitions = sum(step[FIELDS.index("repartitioned")] for step in expected[name])
            self.assertTrue(5 < repartitions < len(path) - 5, (name, repartitions))


if __name__ == "__main__":
    unittest.main(verbosity=2)
