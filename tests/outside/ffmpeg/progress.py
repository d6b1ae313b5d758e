"""progress.py PROGRAM ARGUMENT…: runs the program on a terminal and holds what it says of its progress to the promise.

Total, percentage and time left are shown; nothing is silent for long. A second is promised; a busy machine gets three.
"""
import os
import pty
import re
import select
import sys
import time

SILENT = 3.0


def main():
    process, terminal = pty.fork()
    if process == 0:
        os.environ.update(TERM='xterm', COLUMNS='120')
        os.execv(sys.argv[1], sys.argv[1:])
    said, gaps, last = b'', [], time.monotonic()
    while True:
        select.select([terminal], [], [])
        try:
            more = os.read(terminal, 65536)
        except OSError:  # Linux's way to say that the other side is closed
            break
        if not more:
            break
        now = time.monotonic()
        gaps.append((now - last, said[-80:]))
        said, last = said + more, now
    _, status = os.waitpid(process, 0)
    text = said.decode(errors='replace')
    if os.waitstatus_to_exitcode(status) != 0:
        sys.exit(f'the program failed:\n{text}')
    longest, before = max(gaps)
    if longest > SILENT:
        sys.exit(f'silent for {longest:.1f} s, expected at most {SILENT}; before: {before}')
    if not re.search(r'\d+% \d+/\d+ .*left', text):
        sys.exit(f'expected percentage, number of all and time left, found:\n{text[-2000:]}')
    print(f'on a terminal: silent for {longest:.2f} s at most in {len(gaps)} writings')


main()
