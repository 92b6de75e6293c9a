"""Arrays of all kinds, and what is no array, number or name that can be accepted: a message, or the right answer."""
import copy
import gc
import os
import pickle

from expect import *


class Arrays(WithClient):
    def test_layouts_and_types(self):
        """The same points in whatever memory: the same parts."""
        scene = self.opened()
        exact = np.round(points() * 1024) / 1024
        cuts_of = exact.astype(np.float32)
        wide = np.zeros((len(exact) * 2, 5))
        wide[::2, 1:4] = exact
        unaligned = np.frombuffer(b"x" + exact.tobytes(), np.uint8)[1:].view(np.float64).reshape(-1, 3)
        read_only = exact.copy()
        read_only.flags.writeable = False
        self.assertFalse(unaligned.flags.aligned)
        layouts = {"single": cuts_of, "fortran": np.asfortranarray(exact), "transposed": np.ascontiguousarray(exact.T).T,
                   "rows and columns": wide[::2, 1:4], "unaligned": unaligned, "read only": read_only,
                   "backwards": exact[::-1].copy()[::-1], "columns backwards": exact[:, ::-1].copy()[:, ::-1],
                   "other byte order": exact.astype(">f8"), "list": exact.tolist(), "memory": memoryview(exact),
                   "not masked": np.ma.array(exact), "subclass": exact.view(np.recarray), "half": exact.astype(np.float16)}
        for name, xyz in layouts.items():
            with self.subTest(name):
                rows = np.asarray(xyz).astype(np.float64)
                step = scene.step(xyz)
                np.testing.assert_array_equal(step.parts, scene.cuts.owner(rows))
                if name != "half":
                    np.testing.assert_array_equal(rows, exact)
        whole = np.round(points() * 100)
        for kind in (np.int8, np.uint16, np.int32, np.int64, ">i4"):
            step = scene.step(whole.astype(kind))
            np.testing.assert_array_equal(step.parts, scene.cuts.owner(whole))

    def test_few_rows_and_dims(self):
        for dims in (1, 2, 3):
            scene = self.client.scene(f"few{dims}", 2, replace=True, dims=dims)
            self.assertEqual(scene.step(np.empty((0, dims))).report.n, 0)
            one = np.full((1, dims), 0.5)
            self.assertEqual(scene.step(one, [7], inserted=1).report.n, 1)
            self.assertEqual(len(scene.step(np.broadcast_to(one, (4, dims)), [7, 8, 9, 10], inserted=3).parts), 4)
            self.assertEqual(len(scene.cuts.owner(np.empty((0, dims)))), 0)
            if dims == 1:
                self.assertEqual(len(scene.step(np.arange(4.0), [7, 8, 9, 10]).parts), 4)
                self.assertEqual(len(scene.cuts.owner([0.5, 0.25])), 2)

    def test_wrong_positions(self):
        scene = self.opened()
        xyz = points()
        scene.step(xyz)
        for wrong in (xyz.astype(complex), xyz > 0.5, xyz.astype(object), xyz.astype(str), xyz.astype(np.longdouble), None, "xyz",
                      np.full((9, 3), 2**53 + 1), np.full((9, 3), 2**64 - 1, np.uint64),
                      np.ma.array(xyz, mask=xyz > 0.9), np.zeros((9, 3), "M8[s]")):
            with self.subTest(str(wrong)[:40]), self.assertRaises(TypeError):
                scene.step(wrong)
            with self.subTest(str(wrong)[:40]), self.assertRaises(TypeError):
                scene.cuts.owner(wrong)
        for wrong in (xyz[None], np.float64(1), np.zeros((4, 4)), np.zeros((4, 0)), [[1.0, 2.0], [3.0]]):
            with self.subTest(str(wrong)[:40]), self.assertRaises(ValueError):
                scene.step(wrong)
        for wrong in (xyz[:, :2], xyz[:, 0]):
            with self.fails("invalid_argument", "dimensions"):
                scene.step(wrong)
            with self.assertRaisesRegex(ValueError, "for cuts of 3 dimensions"):
                scene.cuts.halo(wrong, 0.1)
        with self.fails("invalid_argument", "dims 2, in place of this one (replace)"):
            scene.step(xyz[:, :2])
        with self.assertRaisesRegex(ValueError, r"one position as \(1, 3\)"):
            scene.cuts.owner([0.5, 0.5, 0.5])
        for value in (np.nan, np.inf):
            bad = xyz.copy()
            bad[17, 1] = value
            with self.fails("not_finite", "17"):
                scene.step(bad)
            with self.fails("not_finite", "17"):
                scene.cuts.owner(bad)
            with self.fails("not_finite"):
                scene.cuts.halo(bad, 0.1)
        self.assertEqual(scene.last_step, 0)

    def test_ids_and_weights(self):
        scene = self.opened()
        xyz = points(100)
        ids = np.arange(100) * 3
        weights = np.linspace(1, 2, 100)
        expected = scene.step(xyz, ids, weights).parts
        for kind in (np.int16, np.int32, np.uint64, ">i8"):
            np.testing.assert_array_equal(scene.step(xyz, ids.astype(kind)).parts, expected)
        np.testing.assert_array_equal(scene.step(xyz, np.repeat(ids, 2)[::2], np.repeat(weights, 2)[::2]).parts, expected)
        np.testing.assert_array_equal(scene.step(xyz, ids.tolist(), weights.tolist()).parts, expected)
        scene.step(xyz, ids, weights.astype(np.float32))
        for wrong in (ids.astype(float), ids > 3, np.full(100, 2**63, np.uint64), ["a"] * 100, np.ma.array(ids, mask=ids < 9)):
            with self.assertRaises(TypeError):
                scene.step(xyz, wrong)
        for wrong in (ids[:99], ids[None], 5):
            with self.assertRaises(ValueError):
                scene.step(xyz, wrong)
        for wrong in (weights[1:], np.ones((100, 1))):
            with self.assertRaises(ValueError):
                scene.step(xyz, ids, wrong)
        with self.assertRaises(TypeError):
            scene.step(xyz, ids, weights.astype(complex))
        with self.fails("duplicate_id"):
            self.client.scene("twice", 8, replace=True).step(xyz, np.where(ids == 3, 6, ids))
        with self.fails("invalid_argument"):
            scene.step(xyz, np.where(ids == 3, -1, ids), weights)
        for value in (-1.0, np.nan):
            with self.assertRaises(rcbd.Error):
                scene.step(xyz, ids, np.where(ids == 3, value, weights))
        scene.step(xyz[:90], ids[:90], weights[:90], removed=10)
        with self.fails("not_conserved"):
            scene.step(xyz[:80], ids[:80], weights[:80], removed=5)

    def test_wrap(self):
        lo, hi = np.array([-0.1, -np.inf, 0]), np.array([0.7, np.inf, 3])
        at = points() * 9 - 4
        at[:3, 0] = lo[0], hi[0], np.nextafter(lo[0], -1)
        expected = rcbd.wrap(at.copy(), lo, hi)
        self.assertTrue((expected >= lo).all() and (expected < hi).all())
        inside = (at >= lo) & (at < hi)
        np.testing.assert_array_equal(expected[inside], at[inside])
        turns = (at - expected)[:, [0, 2]] / (hi - lo)[[0, 2]]
        np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
        wide = np.zeros((len(at) * 2, 5))
        for xyz in (at.copy(), np.asfortranarray(at), wide[::2, 1:4], at.copy()[::-1], at.astype(">f8"),
                    np.frombuffer(bytearray(b"x" + at.tobytes()), np.uint8)[1:].view(np.float64).reshape(-1, 3)):
            xyz[...] = at
            self.assertIs(rcbd.wrap(xyz, lo, hi), xyz)
            np.testing.assert_array_equal(xyz, expected)
        single = rcbd.wrap(at.astype(np.float32), -0.1, 0.7)
        self.assertTrue((single.astype(float) >= -0.1).all() and (single.astype(float) < 0.7).all())
        self.assertEqual(rcbd.wrap(np.array([1.25, -0.25]), 0, 1).tolist(), [0.25, 0.75])
        for wrong in (at.astype(int), at.tolist(), None, at.astype(np.longdouble)):
            with self.assertRaises(TypeError):
                rcbd.wrap(wrong, 0, 1)
        for wrong, box in ((np.broadcast_to(at[0], (3, 3)), (0, 1)), (at, ([0, 0], 1)), (at[None], (0, 1))):
            with self.assertRaises(ValueError):
                rcbd.wrap(wrong, *box)
        for box in ((1, 0), (0, np.inf), (np.nan, 1)):
            with self.fails("invalid_argument"):
                rcbd.wrap(at, *box)
        before = at.copy()
        at[-1, 2] = before[-1, 2] = np.nan
        with self.fails("not_finite"):
            rcbd.wrap(at, 0, 1)
        np.testing.assert_array_equal(at, before)


class Calls(WithClient):
    def test_wrong_options(self):
        with self.fails("unavailable"):
            rcbd.connect("unix:/nonexistent/rcbd.sock")
        for wrong in ({"path": "around"}, {"name": "a\0b"}, {"deadline_seconds": -1}, {"deadline_seconds": float("nan")}):
            with self.fails("invalid_argument"):
                rcbd.connect(**wrong)
        for wrong in ({"endpoint": 5}, {"deadline_seconds": "1"}, {"token": b"x"}):
            with self.assertRaisesRegex(TypeError, next(iter(wrong))):
                rcbd.connect(**wrong)
        for wrong in ({"parts": -1}, {"parts": 2**40}, {"dims": 4}, {"method": "zoltan"}, {"policy": "none"}, {"positions": "never"},
                      {"tolerance": -1}, {"tolerance": float("nan")}, {"axis_hysteresis": 0.5}, {"cut_tolerance": 2}, {"threads": 0},
                      {"seat": 3}, {"seats": 0}, {"part_sizes": [0.0] * 8}, {"deadline_seconds": 0}, {"seats": 2000}):
            with self.subTest(wrong), self.fails("invalid_argument"):
                self.opened(**wrong)
        for wrong in ({"parts": 1.5}, {"parts": "8"}, {"method": 3}, {"tolerance": "a"}):
            with self.subTest(wrong), self.assertRaises(TypeError):
                self.opened(**wrong)
        for wrong in ([1.0] * 7, 1.0):
            with self.assertRaisesRegex(ValueError, "for 8 parts; give one a part"):
                self.opened(part_sizes=wrong)
        with self.fails("invalid_argument"):
            self.client.scene("a b", 8)
        with self.fails("invalid_argument"):
            self.client.scene(None, 8)
        with self.fails("not_found"):
            self.client.scene("nowhere")
        with self.fails("not_found"):
            self.client.drop("nowhere")

    def test_wrong_steps(self):
        scene = self.opened()
        with self.fails("not_found"):
            scene.cuts
        self.assertIsNone(scene.last_step)
        xyz = points(100)
        for wrong in ({"step": -1}, {"threads": 0}, {"deadline_seconds": 0}, {"deadline_seconds": float("nan")}, {"inserted": -1},
                      {"step_seconds": -1.0}, {"step_seconds": float("nan")}, {"threads": 2**40}, {"threads": 1.5}, {"step": 2**70}):
            with self.subTest(wrong), self.fails("invalid_argument"):
                scene.step(xyz, **wrong)
        scene.step(xyz, step=5)
        with self.fails("stale_step"):
            scene.step(xyz, step=5)
        step = scene.step(xyz, want_parts=False, want_changed=False)
        for name in ("parts", "changed", "changed_parts"):
            with self.fails("not_found", "want_"):
                getattr(step, name)
        self.assertEqual((len(step.leaving.rows), step.rows, step.report.step), (0, 100, 6))
        with self.fails("already_exists", "parts"):
            other = rcbd.connect()
            self.addCleanup(other.close)
            scene.close()
            other.scene("test_wrong_steps", 9)

    def test_closed(self):
        with rcbd.connect() as client:
            with client.scene("closed", 8, replace=True) as scene:
                scene.step(points())
                cuts = scene.cuts
            for call in (lambda: scene.step(points()), lambda: scene.step_begin(points()).wait(), lambda: scene.cuts,
                         lambda: scene.last_step, lambda: scene.positions(9)):
                with self.fails("invalid_argument", "closed"):
                    call()
            scene.close()
        for call in (lambda: client.scene("closed"), lambda: client.drop("closed")):
            with self.fails("invalid_argument", "closed"):
                call()
        client.close()
        client.interrupt()
        self.assertEqual(cuts.parts, 8)

    def test_shared_arrays(self):
        scene = self.opened()
        for wrong in (-1, 2**62):
            with self.assertRaises(rcbd.Error):
                scene.positions(wrong)
        for wrong in (1.5, "9", None):
            with self.assertRaises(TypeError):
                scene.positions(wrong)
        with self.assertRaises(TypeError):
            scene.positions(9, int)
        self.assertEqual((scene.positions(0).shape, scene.positions(5, np.float32).dtype), ((0, 3), np.float32))
        xyz = scene.positions(3000)
        xyz[:] = points()
        self.assertEqual(scene.step(xyz[:2000]).report.n, 2000)

    def test_questions(self):
        scene = self.opened()
        xyz = points()
        scene.step(xyz)
        cuts = scene.cuts
        for width in (-1.0, np.nan, np.inf):
            with self.fails("invalid_argument"):
                cuts.halo(xyz, width)
        for wrong in (np.ones(5), np.ones((3000, 2))):
            with self.assertRaises(ValueError):
                cuts.halo(xyz, wrong)
        for wrong in ((0, 1, 2), 5, (0, [1, 1])):
            with self.assertRaises(ValueError):
                cuts.halo(xyz, 0.1, wrong)
        for wrong in ((1, 0), (0, np.inf)):
            with self.fails("invalid_argument"):
                cuts.halo(xyz, 0.1, wrong)
        with self.fails("invalid_argument"):
            cuts.halo(xyz, 0.1, norm="manhattan")
        with self.fails("too_large"):
            cuts.halo(xyz, 0.1, entries_max=10)
        for wrong in ("0.1", None, [None] * 3000):
            with self.assertRaisesRegex(TypeError, "width"):
                cuts.halo(xyz, wrong)
        with self.assertRaises(ValueError):
            cuts.owner(xyz, last=[1, 2])
        for wrong in (np.full(3000, 2**31), np.zeros(3000)):
            with self.assertRaisesRegex(TypeError, "last"):
                cuts.owner(xyz, last=wrong)
        np.testing.assert_array_equal(cuts.owner(xyz, last=np.full(3000, 99)), cuts.owner(xyz))
        for part in (-1, 8):
            with self.fails("not_found"):
                cuts.neighbours(part, 0.1)
        with self.assertRaises(TypeError):
            cuts.neighbours(1.5, 0.1)
        with self.assertRaises(ValueError):
            cuts.box([0, 0], 1)
        with self.assertRaises(IndexError):
            cuts.halo(xyz, 0.1)[8]
        with self.assertRaisesRegex(TypeError, "list of a halo"):
            cuts.halo(xyz, 0.1)[0:2]
        with self.fails("not_found"):
            cuts.halo(xyz, 0.1).shifts_for(0)

    def test_values(self):
        """A report can be copied and sent, also when nothing else of the step is there; names say who is who."""
        report = self.opened().step(points()).report
        again = [copy.copy(report), copy.deepcopy(report), pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(report))))]
        words = (repr(report), report.reason, report.way, report.json)
        del report
        gc.collect()
        for other in again:
            self.assertEqual((repr(other), other.reason, other.way, other.json), words)
            self.assertIsInstance(other, rcbd.Report)
        self.assertNotIn("json", words[0])
        self.assertEqual(repr(self.client), f"<rcbd.Client of {os.environ['RCBD_ENDPOINT']}>")
        with rcbd.connect() as other, self.assertRaisesRegex(rcbd.Error, "misuse.py"):
            mine = self.client.scene("theirs", 2, replace=True)
            mine.step(points())
            other.scene("theirs", 2, replace=True, deadline_seconds=0.1)


if __name__ == "__main__":
    unittest.main(verbosity=2)
