"""What the tests of the Python package share: a service to be asked, points, and failures that are expected. Each is run by
tests/e2e/python_test.py, with RCBD_ENDPOINT, RCBD_LIBRARY and PYTHONPATH set."""
import contextlib
import unittest

import numpy as np

import rcbd

SEED = 4304


def points(n=3000, dims=3, seed=SEED):
    return np.random.default_rng(seed).random((n, dims))


class WithClient(unittest.TestCase):
    def setUp(self):
        self.client = rcbd.connect()
        self.addCleanup(self.client.close)

    def opened(self, parts=8, **options):
        return self.client.scene(self.id().split(".")[-1], parts, replace=True, **options)

    @contextlib.contextmanager
    def fails(self, code, words=""):
        with self.assertRaises(rcbd.Error) as caught:
            yield
        failure = caught.exception
        self.assertEqual(failure.code, code, failure)
        self.assertIn(words, str(failure))
        self.assertGreater(len(failure.message), 5)
        self.assertTrue(str(failure).startswith(failure.message) and failure.hint in str(failure))
