"""Style of comments and pages: widths, lengths of sentences, words that are not used.

python3 .ci/prose.py           checks every file that git lists
python3 .ci/prose.py PATH...   checks those below the paths

1. Comment lines in Rust have at most 120 characters. Fences, tables and lines that are one long URL are excepted.
2. Pages in Markdown have on average at most 20 words a sentence, and no sentence of more than 45. An item of a list is a sentence; inline code is one word.
   Fences, tables, headings and HTML are left out.
3. Comments in Rust, Python, JavaScript and shell, and pages, contain none of WORN. Code in them is left out.
"""
import ast
import io
import pathlib
import re
import subprocess
import sys
import tokenize

ROOT = pathlib.Path(__file__).resolve().parents[1]
WIDTH, AVERAGE, LONGEST = 120, 20, 45
WORN = re.compile(r'\b(gone\s+on|asked\s+for|besides?|nobody|whoever|gives)\b', re.IGNORECASE)
# Written by tests or programs from text that is elsewhere, or a record of the past.
GENERATED = re.compile(r'docs/api/.*|docs/cli\.md|tests/extremes/REPORT\.md|CHANGELOG\.md|(.*/)?LICENSE.*')
WRITTEN = re.compile(r'<!-- (?:table of .*?|.* from here) -->.*?<!-- (?:end|to here) -->', re.DOTALL)
FENCE = re.compile(r'^[ ]*(```+|~~~+).*?^[ ]*\1[ ]*$', re.MULTILINE | re.DOTALL)
STRINGS = r'(?<!\w)b?r(#*)".*?"\1|"(?:\\.|[^"\\])*"'
RUST = re.compile(STRINGS + r"|b?'(?:\\[^\n]+?|[^'\\\n])'|(?P<comment>//[^\n]*|/\*.*?\*/)", re.DOTALL)
SCRIPT = re.compile(r"'(?:\\.|[^'\\\n])*'" + r'|"(?:\\.|[^"\\\n])*"|`(?:\\.|[^`\\\n])*`|(?P<comment>(?<![:\\/\w])//[^\n]*|/\*.*?\*/)', re.DOTALL)
SHELL = re.compile(r'(?P<comment>(?:^|(?<=\s))#[^\n]*)', re.MULTILINE)
ITEM = re.compile(r'[ ]*(?:(?:[-*]|\d+\.)[ ]+)?')
MARKER = re.compile(r'^[ ]*(//[/!]?|/\*+|\*+/?(?=\s|$)|#+!?)', re.MULTILINE)


def blank(text):
    """As many lines, all empty: what stays keeps its line number."""
    return '\n' * text.count('\n')


def parts(text, spans):
    """The text within spans of offsets, in order, and empty lines for the rest."""
    kept, end = '', 0
    for first, last in spans:
        kept += blank(text[end:first]) + text[first:last]
        end = last
    return kept + blank(text[end:])


def without_code(text):
    text = FENCE.sub(lambda fence: blank(fence[0]), text)
    return re.sub(r'(`+)(?:(?!\n\s*\n)[^`])+?\1', lambda code: 'code' + blank(code[0]), text)


def without_blocks(page):
    """A page without what a test writes and without indented code, which lists do not have."""
    lines, in_list, before = WRITTEN.sub(lambda block: blank(block[0]), page).split('\n'), False, ''
    for i, line in enumerate(lines):
        if line.strip():
            in_list = bool(re.match(r'[ ]*(?:[-*]|\d+\.)[ ]', line)) or in_list and line.startswith(' ')
            if line.startswith('    ') and not before.strip() and not in_list:
                line = lines[i] = ''
        before = line
    return '\n'.join(lines)


def python(text):
    """Comments and documentation strings."""
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    documented = {node.body[0].value.lineno for node in ast.walk(ast.parse(text))
                  if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and ast.get_docstring(node) is not None}
    tokens = [token for token in tokenize.generate_tokens(io.StringIO(text).readline)
              if token.type == tokenize.COMMENT or token.type == tokenize.STRING and token.start[0] in documented]
    return parts(text, [tuple(starts[line - 1] + column for line, column in (token.start, token.end)) for token in tokens])


def comments(name, text):
    """A file's comments, or None where it is of no known language."""
    if name.endswith('.py') or re.match(r'#!.*python', text):
        found = python(text)
    elif name.endswith('.rs'):
        found = parts(text, [match.span() for match in RUST.finditer(text) if match['comment']])
    elif name.endswith(('.js', '.mjs')):
        found = parts(text, [match.span() for match in SCRIPT.finditer(text) if match['comment']])
    elif name.endswith('.sh') or re.match(r'#!.*sh\b', text):
        found = parts(text, [match.span() for match in SHELL.finditer(text)])
    else:
        return None
    return without_code(MARKER.sub('', found))


def sentences(page):
    """The sentences of a page without code: line number and words of each."""
    page = re.sub(r'<!--.*?-->|<[^<>]+>', lambda html: blank(html[0]), page, flags=re.DOTALL)
    page = re.sub(r'!?\[([^\]]*)\]\([^)]*\)', r'\1', page)
    page = re.sub(r'^(#|[ ]*\|).*$', '', page, flags=re.MULTILINE)
    for block in re.finditer(r'^[ ]*\S.*(?:\n(?![ ]*(?:[-*]|\d+\.)[ ])[ ]*\S.*)*', page, re.MULTILINE):
        end = block.start() + len(ITEM.match(block[0])[0])
        for stop in [*re.finditer(r'(?<!e\.g)(?<!i\.e)[.!?][)"”*]*(?=\s)', block[0]), re.search(r'\Z', block[0])]:
            if block.start() + stop.end() <= end:
                continue
            sentence = page[end:block.start() + stop.end()]
            words = [word for word in sentence.split() if re.search(r'\w', word)]
            if words:
                yield page.count('\n', 0, end + len(sentence) - len(sentence.lstrip())) + 1, words
            end = block.start() + stop.end()


def check(name, text):
    """What is wrong in a file, a line each."""
    page = without_blocks(without_code(text)) if name.endswith('.md') else None
    prose = comments(name, text) if page is None else page
    if prose is None:
        return
    if name.endswith('.rs'):
        in_fence = False
        for number, line in enumerate(text.splitlines(), 1):
            comment = re.match(r'\s*//[/!]?(.*)', line)
            in_fence ^= bool(comment and comment[1].lstrip().startswith('```'))
            if comment and len(line) > WIDTH and not in_fence and not re.match(r'\s*(\||\S*://\S+$)', comment[1]):
                yield f'{name}:{number}: expected a comment of at most {WIDTH} characters, found {len(line)}'
    if page is not None:
        lengths = []
        for number, words in sentences(page):
            lengths.append(len(words))
            if len(words) > LONGEST:
                yield f'{name}:{number}: expected at most {LONGEST} words in a sentence, found {len(words)}: {" ".join(words[:8])} ...'
        if lengths and sum(lengths) > AVERAGE * len(lengths):
            yield f'{name}:1: expected at most {AVERAGE} words a sentence on average, found {sum(lengths) / len(lengths):.1f}'
    for word in WORN.finditer(prose):
        yield f'{name}:{prose.count(chr(10), 0, word.start()) + 1}: expected a plainer word, found "{" ".join(word[0].split())}"'


def main():
    listed = subprocess.run(['git', 'ls-files', '-z', '--', *sys.argv[1:]], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    wrong = 0
    for name in filter(None, listed.split('\0')):
        if GENERATED.fullmatch(name) or not (ROOT / name).is_file():
            continue
        try:
            text = (ROOT / name).read_text(encoding='utf-8')
        except UnicodeDecodeError:
            continue
        for line in check(name, text):
            wrong += 1
            print(line)
    if wrong:
        sys.exit(f'{wrong} lines or pages to write again: CONTRIBUTING.md, "Style"')


main()
