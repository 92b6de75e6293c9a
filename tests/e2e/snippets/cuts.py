# Ten thousand points in a cube, in 8 parts: what the README shows of their cuts.
import numpy as np

import rcbd

xyz = np.random.default_rng(1).random((10000, 3))
scene = rcbd.connect().scene("cube", parts=8, replace=True)
step = scene.step(xyz)
SNIPPET
assert (part == step.parts).all()
for p in range(8):
    assert 0 < len(halo[p]) < 9000
