"""Steps once, and again when told to; the service is stopped in between."""
import logging

import rcbd

logging.basicConfig(format="%(name)s: %(message)s")
with rcbd.connect() as client:
    scene = client.scene("waiting", 2, replace=True)
    scene.step([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    print("stepped", flush=True)
    input()
    try:
        scene.step([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]], deadline_seconds=1.5)
    except rcbd.Error as failure:
        print("ended:", failure.code, failure)
