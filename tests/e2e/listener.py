"""What stands between a client and a service: an impostor, a relay, a tunnel."""
import contextlib
import socket
import threading


class Listener:
    """Takes a port, or a Unix socket's path, or has a listening socket already; each connection is served, in a thread of
    its own, by `script(listener, connection)`. `heard` has all bytes that clients sent, as far as they were read here."""

    def __init__(self, place, script):
        self.heard, self.script, self.threads = bytearray(), script, []
        if isinstance(place, str):
            place = socket.create_server(place, family=socket.AF_UNIX)
        elif isinstance(place, int):
            place = socket.create_server(("127.0.0.1", place))
        self.socket = place
        self.start(self.serve)

    def start(self, target, *args):
        self.threads.append(threading.Thread(target=target, args=args, daemon=True))
        self.threads[-1].start()
        return self.threads[-1]

    def serve(self):
        while True:
            try:
                made, _ = self.socket.accept()
            except OSError:
                return
            made.settimeout(20)
            self.start(self.attend, made)

    def attend(self, made):
        with made, contextlib.suppress(OSError, EOFError):
            self.script(self, made)

    def read(self, made):
        data = made.recv(65536)
        if not data:
            raise EOFError
        self.heard += data
        return data

    def pass_on(self, client, service):
        """Both ways, until either ends."""
        with client, service:
            back = self.start(self.copy, service, client)
            self.copy(client, service, self.heard)
            back.join(30)

    @staticmethod
    def copy(source, target, kept=None):
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                if kept is not None:
                    kept += data
                target.sendall(data)
        for one in (source, target):
            with contextlib.suppress(OSError):
                socket.socket.shutdown(one, socket.SHUT_RDWR)

    def close(self):
        self.socket.shutdown(socket.SHUT_RDWR)
        self.socket.close()
        for thread in self.threads:
            thread.join(30)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
