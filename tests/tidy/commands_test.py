"""PROTOCOL.md lists every command of the service's table, and every field of it."""
import os
import re
import unittest

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))


def read(path):
    with open(os.path.join(ROOT, path)) as file:
        return file.read()


def table():
    """{command: its fields} of server/api/commands.cpp."""
    text = read("server/api/commands.cpp")
    fields = {name: re.findall(r'"([^"]+)"', body)
              for name, body in re.findall(r"std::array<Fields, \d+> (k\w+)\{(.*?)\};", text, re.S)}
    commands = re.findall(r'CommandInfo\{"([^"]+)", \w+, \w+, (?:\{\}|(k\w+))[,}]', text)
    return {command: fields.get(name, []) for command, name in commands}


class Commands(unittest.TestCase):
    def test_protocol_names_every_command_and_field(self):
        protocol = read("common/wire/PROTOCOL.md")
        commands = table()
        self.assertGreater(len(commands), 20)
        for command, fields in commands.items():
            self.assertIn(f"`{command}`", protocol)
            for field in fields:
                self.assertRegex(protocol, rf"[`\"]{field}[`\"]", f"{command}: {field}")


if __name__ == "__main__":
    unittest.main()
