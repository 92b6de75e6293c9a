"""librcbd.so.1 as programs in C99 see it: one history whoever tells it, every misuse a message, and what was promised stays."""
import re

from languages import *

LIBRARY = os.path.join(LIB, "librcbd.so.1")

# A program that only connects: prints the code, the message and the hint.
CONNECT = """
import ctypes, sys
library = ctypes.CDLL(sys.argv[1])
library.rcbd_message.restype = library.rcbd_hint.restype = ctypes.c_char_p
print(library.rcbd_connect(sys.argv[2].encode(), None, ctypes.byref(ctypes.c_void_p())))
print(library.rcbd_message().decode(), library.rcbd_hint().decode(), sep=chr(10))
"""


class CLibrary(LanguageTest):
    def test_one_history(self):
        self.one_history([os.path.join(BIN, "c_history")])

    def test_misuse(self):
        self.cases_of("c_misuse", 8)

    def test_near(self):
        self.cases_of("c_near", 2)

    def test_surroundings(self):
        self.cases_of("c_surroundings", 7)

    def test_a_lost_service_is_told_when_asked_for(self):
        """A service that was stopped is waited for; the notices say so."""
        with Service(1) as service:
            program = subprocess.Popen([os.path.join(BIN, "c_waiting"), service.endpoint], stdout=subprocess.PIPE,
                                       stderr=subprocess.PIPE, stdin=subprocess.PIPE, text=True)
            try:
                self.assertEqual(program.stdout.readline(), "stepped\n")
                service.ctl("down", check=True)
                text, complaints = program.communicate("\n", timeout=60)
            finally:
                program.kill()
                program.wait()
        self.assertEqual((program.returncode, complaints), (0, ""))
        self.assertRegex(text, "notice: .*stopped")
        self.assertRegex(text, "ended: unavailable: ")

    def test_the_serial_example(self):
        done = run(program=os.path.join(BIN, "serial_c"), endpoint=self.service.endpoint, check=True)
        self.assertIn("has reached the tolerance", done.stdout)
        history = self.service.json("history", "serial")
        self.assertEqual([report["step"] for report in history], list(range(101)))
        self.assertEqual(len(done.stdout.splitlines()), sum(report["repartitioned"] for report in history))
        failed = run(program=os.path.join(BIN, "serial_c"), endpoint="unix:/nonexistent/rcbd.sock")
        self.assertEqual(failed.returncode, 1)
        self.assertIn("no service answers", failed.stderr)

    def test_what_was_promised_stays(self):
        """Names, and the places of all fields. Whoever adds some adds them to the table; none goes, or moves."""
        names = [line.split()[-1] for line in run("-D", "--defined-only", LIBRARY, program="/usr/bin/nm", check=True).stdout.splitlines()]
        names = sorted(name.removesuffix("@@RCBD_1") for name in names if name != "RCBD_1")
        printed = [*names, *run(program=os.path.join(BIN, "c_abi"), check=True).stdout.splitlines()]
        self.assertEqual(printed, text_of(ROOT, "tests/client/c/abi.txt").splitlines())
        header = re.sub(r"/\*.*?\*/", "", text_of(ROOT, "client/include/rcbd/rcbd.h"), flags=re.S)
        declared = re.findall(r"^(?:int|void\*?|const char\*) (rcbd_\w+)\(", header, re.M)
        self.assertEqual(sorted(declared), names)
        fields = sum(body.count(";") + body.count(", ") for body in re.findall(r"typedef struct \w+ \{(.*?)\} ", header, re.S))
        self.assertEqual(sum("." in line for line in printed), fields)

    def test_it_needs_little(self):
        """Neither MPI nor HDF5 nor any library that must be there at the same version as where it was built."""
        dynamic = run("-d", LIBRARY, program="/usr/bin/readelf", check=True).stdout
        needed = set(re.findall(r"NEEDED.*\[(.*)\]", dynamic))
        self.assertLessEqual(needed, {"libstdc++.so.6", "libm.so.6", "libgcc_s.so.1", "libc.so.6", "ld-linux-x86-64.so.2",
                                      "ld-linux-aarch64.so.1"})
        self.assertRegex(dynamic, r"SONAME.*\[librcbd\.so\.1\]")
        self.assertRegex(dynamic, "FLAGS_1.*NODELETE")
        service = run("-d", os.path.join(BIN, "rcbd"), program="/usr/bin/readelf", check=True).stdout
        self.assertIn("libmpi", service)
        self.assertNotIn("libhwy", service)  # whose headers alone are used

    def test_openssl_is_opened_when_tcp_is_used(self):
        """Where it isn't there, or is another library of that name, Unix sockets do without, and TCP says what is missing."""
        serial, folder = os.path.join(BIN, "serial_c"), os.path.join(self.dir, "without")
        os.mkdir(folder)
        hidden = os.path.join(folder, "libssl.so.3")
        without = {"LD_LIBRARY_PATH": folder}
        with Service(1, tcp=f"127.0.0.1:{free_port()}") as service:
            run(program=serial, endpoint=service.endpoint, check=True)
            history = service.json("history", "serial")
            for hide in (lambda: write_text(hidden, ""), lambda: os.symlink(os.path.abspath(LIBRARY), hidden)):
                hide()
                run(program=serial, endpoint=self.service.endpoint, env=without, check=True)
                done = run("-c", CONNECT, LIBRARY, service.endpoint, program=sys.executable, env=without, check=True)
                code, message, hint = done.stdout.splitlines()
                self.assertEqual(code, "16")  # RCBD_UNSUPPORTED
                self.assertRegex(message, "^OpenSSL can't be opened here: .*(file too short|undefined symbol: ASN1_INTEGER_set)")
                self.assertRegex(hint, "^TCP needs it: .*libssl3.*Unix socket")
                os.unlink(hidden)
            self.assertEqual(service.json("history", "serial"), history)


if __name__ == "__main__":
    unittest.main(verbosity=2)
