"""What cuts answer, against the definitions; what stays valid, and how long."""
import gc
import itertools
import weakref

from expect import *

LO, HI = np.array([0, -np.inf, 0]), np.array([1, np.inf, 1])


def brute_halo(cuts, xyz, width, norm, owner, parts_of):
    """By list: (row, shift) of the particles whose image is within the width of one of its parts' regions."""
    lo, hi = cuts.regions()
    lo, hi = np.where(np.isinf(lo), LO, lo), np.where(np.isinf(hi), HI, hi)
    lists = []
    for parts in parts_of:
        found = set()
        for shift in itertools.product((-1, 0, 1), (0,), (-1, 0, 1)):
            image = xyz + shift
            for q in parts:
                apart = np.maximum(np.maximum(lo[q] - image, image - hi[q]), 0)
                distance = apart.max(axis=1) if norm == "max" else np.sqrt((apart**2).sum(axis=1))
                rows = np.flatnonzero(distance <= width)
                if not any(shift):
                    rows = rows[~np.isin(owner[rows], parts)]
                found |= {(int(row), shift) for row in rows}
        lists.append(sorted(found))
    return lists


class Near(WithClient):
    def test_halo(self):
        scene = self.opened()
        xyz = points(1500)
        step = scene.step(xyz)
        cuts = scene.cuts
        np.testing.assert_array_equal(cuts.owner(xyz), step.parts)
        widths = np.random.default_rng(SEED).uniform(0, 0.1, len(xyz))
        for width, norm, seats in itertools.product((0.07, widths), ("max", "euclid"), (0, 3)):
            parts_of = [range(k * 8 // 3, (k + 1) * 8 // 3) for k in range(3)] if seats else [[q] for q in range(8)]
            halo = cuts.halo(xyz, width, (LO, HI), norm=norm, seats=seats, threads=2)
            expected = brute_halo(cuts, xyz, width, norm, step.parts, parts_of)
            self.assertEqual(len(halo), len(expected))
            self.assertGreater(len(halo.rows), 100)
            for k, entries in enumerate(expected):
                found = list(zip(halo[k].tolist(), map(tuple, halo.shifts_for(k).tolist())))
                self.assertEqual(found, entries, f"seed {SEED}")
        open_halo = cuts.halo(xyz, 0.07)
        self.assertIsNone(open_halo.shifts)
        for rows, periodic in zip(open_halo, cuts.halo(xyz, 0.07, (LO, HI))):
            self.assertLessEqual(set(rows), set(periodic))

    def test_neighbours_boxes_regions(self):
        scene = self.opened()
        scene.step(points())
        cuts = scene.cuts
        lo, hi = cuts.regions()
        self.assertEqual((lo.shape, len(cuts.hash), int(cuts.hash, 16) >= 0, cuts.dims), ((8, 3), 16, True, 3))
        gap = np.maximum(lo[:, None] - hi[None], lo[None] - hi[:, None]).max(axis=2)
        for q in range(8):
            np.testing.assert_array_equal(cuts.neighbours(q, 0.05), [p for p in range(8) if p != q and gap[q, p] <= 0.05])
            parts, shifts = cuts.neighbour_images(q, 0.05, (0, 1))
            self.assertEqual(shifts.shape, (len(parts), 3))
            self.assertEqual(sorted(set(parts)), cuts.neighbours(q, 0.05, (0, 1)).tolist())
        corner = ([0.1, 0.1, 0.1], [0.2, 0.3, 0.2])
        expected = [q for q in range(8) if (lo[q] <= corner[1]).all() and (hi[q] >= corner[0]).all()]
        np.testing.assert_array_equal(cuts.box(*corner), expected)
        self.assertEqual(cuts.box(0, 1).tolist(), list(range(8)))
        width = np.where(np.isinf(hi), 1, hi) - np.where(np.isinf(lo), 0, lo)
        part, axis, narrowest = cuts.narrowest((0, 1))
        self.assertEqual(narrowest, width.min())
        self.assertEqual(width[part, axis], narrowest)
        self.assertIsNone(cuts.narrowest())


class Lifetimes(WithClient):
    def test_arrays_outlive_all(self):
        scene = self.opened()
        xyz = scene.positions(3000)
        xyz[:] = points()
        kept = xyz.copy()
        first = scene.step(xyz)
        cuts = scene.cuts
        halo = cuts.halo(xyz, 0.1, (0, 1))
        arrays = [xyz, first.parts, first.changed, first.changed_parts, halo.rows, halo.shifts, halo[3], *cuts.regions(),
                  cuts.box(0, 1), cuts.neighbours(0, 1), scene.positions(3000)[5:9, 1]]
        before = [array.copy() for array in arrays]
        told = first.report
        larger = scene.positions(500_000)
        np.testing.assert_array_equal(larger[:3000], kept)
        larger[:] = 0.25
        scene.step(larger[:3000] + points())
        scene.close()
        self.client.close()
        del first, cuts, halo, scene, larger
        self.client = None
        gc.collect()
        junk = [np.full(9000, 7.0) for _ in range(500)]
        for array, copy in zip(arrays, before):
            np.testing.assert_array_equal(array, copy)
        self.assertEqual((told.n, told.reason, len(junk)), (3000, "first positions", 500))
        xyz[:] = 1  # memory of its own, still
        for array in arrays[1:7]:
            self.assertFalse(array.flags.writeable)
            self.assertIsNotNone(array.base)

    def test_nothing_is_kept_for_ever(self):
        scene = self.opened()
        xyz = points()
        step = scene.step(xyz)
        base = step.parts
        while isinstance(base.base, np.ndarray):
            base = base.base
        gone = []
        for thing in (step, xyz, scene.cuts):
            weakref.finalize(thing, gone.append, 1)
        op = scene.step_begin(xyz)
        thing = None
        del xyz
        gc.collect()
        self.assertEqual(sum(gone), 1, "the cuts; the op keeps the array")
        op.wait()
        del op, step
        gc.collect()
        self.assertEqual(sum(gone), 3)

    def test_a_step_reads_what_was_given(self):
        """Temporary arrays, and converted ones, live until the step is made."""
        scene = self.opened()
        for k in range(50):
            op = scene.step_begin((points(seed=k) * 1000).astype(np.int32), np.arange(3000, dtype=np.int32))
            junk = [np.full((3000, 3), np.nan) for _ in range(20)]
            self.assertEqual(op.wait().report.n, 3000)
        self.assertEqual(len(junk), 20)

    def test_changes(self):
        """step.changed names what differs from the step before."""
        scene = self.opened()
        xyz = points()
        told = np.full(len(xyz), -1)
        for _ in range(20):
            step = scene.step(xyz)
            np.testing.assert_array_equal(step.changed, np.flatnonzero(step.parts != told))
            np.testing.assert_array_equal(step.changed_parts, step.parts[step.changed])
            told = step.parts
            xyz[:1500] *= 0.97
        self.assertGreater(step.report.epoch, 2)


if __name__ == "__main__":
    unittest.main(verbosity=2)
