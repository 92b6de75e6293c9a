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

    def step(self, number, points, deadline=60):
        """The report of the step, which is committed once however often the service is lost meanwhile."""
        end, pause = time.monotonic() + deadline, 0
        while True:
            try:
                if self.link is None:
                    self.connect()
                self.attempts += 1
                return self.link.push(self.scene, number, points, attempt=self.attempts)[0]["report"]
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
