"""progress.py SECONDS PROGRAM ARGUMENT…: runs the program on a terminal and checks its progress bar.

The bar shows percentage, total and time left, and is rewritten at least once a second; a busy machine gets three. The run must take at least SECONDS, so that a
bar that is not rewritten while the program waits cannot pass.
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
        os.execv(sys.argv[2], sys.argv[2:])
    start = last = time.monotonic()
    said, gaps = b'', []
    while True:
        select.select([terminal], [], [])
        try:
            more = os.read(terminal, 65536)
        except OSError:  # Linux: the other side is closed
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
    if last - start < float(sys.argv[1]):
        sys.exit(f'the run took {last - start:.1f} s, expected at least {sys.argv[1]}')
    longest, before = max(gaps)
    if longest > SILENT:
        sys.exit(f'silent for {longest:.1f} s, expected at most {SILENT}; before: {before}')
    if not re.search(r'\d+% \d+/\d+ .*left', text):
        sys.exit(f'expected percentage, number of all and time left, found:\n{text[-2000:]}')
    print(f'on a terminal: silent for {longest:.2f} s at most in {len(gaps)} writings')


main()
