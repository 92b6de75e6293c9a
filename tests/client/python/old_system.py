"""With librcbd.so.1 of the archive (deploy/archive), on a system of which nothing else is known: steps, cuts, an exception in
the library, and TCP where there is no OpenSSL 3."""
import os
import platform
import resource
import sys

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # each of which takes memory

import numpy as np

import rcbd

xyz = np.random.default_rng(7).random((2000000, 3))
client = rcbd.connect()
scene = client.scene("old", parts=64, replace=True)
for _ in range(5):
    xyz[:1000000] *= 0.9
    step = scene.step(xyz, np.arange(len(xyz)))
    report = step.report
    assert report.imbalance < 1.11, report
    assert (scene.cuts.owner(xyz) == step.parts).all()

resource.setrlimit(resource.RLIMIT_AS, (1 << 30, resource.RLIM_INFINITY))
try:
    scene.cuts.halo(xyz, 10.0)  # each part needs all: a GB of entries
    raise SystemExit("there was memory enough")
except rcbd.Error as failure:  # the library caught std::bad_alloc
    assert failure.code == "too_large", failure
resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))

try:
    rcbd.connect("127.0.0.1:1")
except rcbd.Error as failure:
    print(f"by TCP: {failure.code}: {failure}")
print(f"{report.n} particles in {report.parts} parts with {rcbd.library_path}, {' '.join(platform.libc_ver())}")
