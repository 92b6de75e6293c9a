"""A client that outlives the service it pushes to, from PROTOCOL.md alone: all that a solver in any language needs for it."""
import os
import random
import time

from protocol_client import Client, Refused

TRY_AGAIN = ("aborted", "unavailable", "busy")  # busy: other commands; the connection before may not have ended yet


class OutlivingClient:
    """One scene, all of whose particles are pushed in each step."""

    def __init__(self, address, scene, **options):
        self.address, self.scene = address, scene
        self.session, self.attempts, self.link = os.urandom(8).hex(), 0, None
        self.connect()
        self.link.ask("scene.create", scene=scene, replace=True, **options)

    def connect(self):
        self.link = Client(self.address, session=self.session)

    def fill(self, number, points):
        """Brings the particles again to a service that was started again, unless it has the step and will say so."""
        scene = self.link.ask("scene.open", scene=self.scene)[0]
        if not scene["filled"] and scene["step"] not in (None, number):
            self.push(scene["step"], points, refill=True)

    def push(self, step, points, **more):
        self.attempts += 1
        return self.link.push(self.scene, step, points, attempt=self.attempts, **more)[0]

    def step(self, number, points, deadline=60):
        """The report of the step, which is committed once however often the service is lost meanwhile."""
        end, pause = time.monotonic() + deadline, 0
        while True:
            try:
                if self.link is None:
                    self.connect()
                    self.fill(number, points)
                return self.push(number, points)["report"]
            except (OSError, EOFError, Refused) as lost:
                if time.monotonic() > end or (isinstance(lost, Refused) and lost.args[0] not in TRY_AGAIN):
                    raise
            self.close()
            time.sleep(pause * random.uniform(0.5, 1))
            pause = min(max(2 * pause, 0.05), 2)

    def close(self):
        if self.link is not None:
            self.link.close()
        self.link = None
