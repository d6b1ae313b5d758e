"""The public interface of the published libraries, one item per line, in docs/api/*.txt.

python3 .ci/api.py          fails where the listing is out of date
python3 .ci/api.py --store  writes it

rustdoc describes each library in JSON; the stable rustdoc does so with RUSTC_BOOTSTRAP set, for rustdoc alone. The listing is that of x86-64 with the default
features.
"""
import difflib
import json
import os
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[1]
CRATES = {'streamsplat-kernels': 'kernels', 'streamsplat-model': 'model', 'streamsplat': 'streamsplat'}


def described(package):
    """rustdoc's description of a library."""
    with tempfile.TemporaryDirectory() as folder:
        rustdoc = pathlib.Path(folder) / 'rustdoc'
        rustdoc.write_text('#!/bin/sh\nRUSTC_BOOTSTRAP=1 exec rustdoc "$@"\n')
        rustdoc.chmod(0o755)
        subprocess.run(['cargo', 'doc', '--release', '--locked', '--no-deps', '--quiet', '--lib', '-p', package],
                       cwd=ROOT, check=True, env=dict(os.environ, RUSTDOC=str(rustdoc), RUSTDOCFLAGS='-Z unstable-options --output-format json'))
    return json.loads((pathlib.Path(os.environ.get('CARGO_TARGET_DIR', ROOT / 'target')) / 'doc' / f'{package.replace("-", "_")}.json').read_text())


class Library:
    def __init__(self, crate):
        self.index, self.lines, self.seen = crate['index'], set(), set()
        root = self.item(crate['root'])
        self.module(root['name'], root)

    def item(self, id):
        return self.index.get(str(id))

    # Types

    def arguments(self, args):
        if not args:
            return ''
        if 'parenthesized' in args:
            of = args['parenthesized']
            return f"({', '.join(map(self.type, of['inputs']))})" + (f" -> {self.type(of['output'])}" if of['output'] else '')
        of = args.get('angle_bracketed', {})
        values = [next(iter(a.values())) if isinstance(a, dict) and 'lifetime' in a else
                  self.type(a['type']) if 'type' in a else a['const']['expr'] if 'const' in a else '_' for a in of.get('args', [])]
        for bound in of.get('constraints', []):
            binding = bound['binding']
            values.append(f"{bound['name']} = {self.type(binding['equality']['type'])}" if 'equality' in binding and 'type' in binding['equality']
                          else f"{bound['name']}: {self.bounds(binding.get('constraint', []))}")
        return f"<{', '.join(values)}>" if values else ''

    def path(self, of):
        return of['path'].rsplit('::', 1)[-1] + self.arguments(of.get('args'))

    def bounds(self, bounds):
        return ' + '.join(self.path(b['trait_bound']['trait']) if 'trait_bound' in b else b.get('outlives', '_') for b in bounds)

    def type(self, of):
        if of is None:
            return '()'
        kind, of = next(iter(of.items())) if isinstance(of, dict) else (of, None)
        match kind:
            case 'resolved_path':
                return self.path(of)
            case 'generic' | 'primitive':
                return of
            case 'tuple':
                return f"({', '.join(map(self.type, of))})"
            case 'slice':
                return f'[{self.type(of)}]'
            case 'array':
                return f"[{self.type(of['type'])}; {of['len']}]"
            case 'borrowed_ref':
                return f"&{of['lifetime'] + ' ' if of['lifetime'] else ''}{'mut ' if of['is_mutable'] else ''}{self.type(of['type'])}"
            case 'raw_pointer':
                return f"*{'mut' if of['is_mutable'] else 'const'} {self.type(of['type'])}"
            case 'impl_trait':
                return f'impl {self.bounds(of)}'
            case 'dyn_trait':
                return 'dyn ' + ' + '.join(self.path(t['trait']) for t in of['traits'])
            case 'qualified_path':
                return f"{self.type(of['self_type'])}::{of['name']}"
            case 'function_pointer':
                return f"fn({', '.join(self.type(t) for _, t in of['sig']['inputs'])}) -> {self.type(of['sig']['output'])}"
        return kind

    def generics(self, of):
        names = []
        for param in of['params']:
            kind = param['kind']
            if 'lifetime' in kind or kind.get('type', {}).get('is_synthetic'):
                continue
            bounds = self.bounds(kind['type']['bounds']) if 'type' in kind else self.type(kind['const']['type'])
            names.append(param['name'] + (f': {bounds}' if bounds else ''))
        return f"<{', '.join(names)}>" if names else ''

    # Items

    def say(self, line):
        self.lines.add(line)

    def module(self, name, item):
        for id in item['inner']['module']['items']:
            self.visit(name, self.item(id))

    def visit(self, within, item, name=None):
        if item is None or item['visibility'] != 'public' and name is None:
            return
        kind, of = next(iter(item['inner'].items()))
        if kind == 'use':
            target = self.item(of['id']) if of['id'] is not None else None
            if target is None:
                self.say(f"use {within}::{of['name']} = {of['source']}")
            elif of['is_glob'] and 'module' in target['inner']:
                self.module(within, target)
            else:
                self.visit(within, target, of['name'])
            return
        path = f"{within}::{name or item['name']}"
        if (path, kind) in self.seen:
            return
        self.seen.add((path, kind))
        match kind:
            case 'module':
                self.say(f'mod {path}')
                self.module(path, item)
            case 'struct' | 'enum' | 'union':
                attributes = '#[non_exhaustive] ' if any('non_exhaustive' in str(a) for a in item['attrs']) else ''
                self.say(f"{attributes}{kind} {path}{self.generics(of['generics'])}")
                self.parts(path, of)
                for id in of['impls']:
                    self.impl(path, self.item(id))
            case 'trait':
                self.say(f"{'unsafe ' if of['is_unsafe'] else ''}trait {path}{self.generics(of['generics'])}")
                for id in of['items']:
                    self.associated(path, self.item(id))
            case 'function':
                self.function(path, item)
            case 'constant':
                self.say(f"const {path}: {self.type(of['type'])}")
            case 'static':
                self.say(f"static {path}: {self.type(of['type'])}")
            case 'type_alias':
                self.say(f"type {path}{self.generics(of['generics'])} = {self.type(of['type'])}")
            case _:
                self.say(f'{kind} {path}')

    def parts(self, path, of):
        """Public fields of a structure, variants of an enumeration."""
        for id in of.get('variants', []):
            variant = self.item(id)
            kind = variant['inner']['variant']['kind']
            fields = ''
            if 'tuple' in kind:
                fields = f"({', '.join(self.type(self.item(f)['inner']['struct_field']) if f is not None else '_' for f in kind['tuple'])})"
            elif 'struct' in kind:
                of_it = [self.item(f) for f in kind['struct']['fields']]
                fields = f" {{ {', '.join(f['name'] + ': ' + self.type(f['inner']['struct_field']) for f in of_it)} }}"
            self.say(f"variant {path}::{variant['name']}{fields}")
        kind = of.get('kind', 'unit')
        ids = kind['plain']['fields'] if 'plain' in kind else kind['tuple'] if 'tuple' in kind else []
        for field in (self.item(id) for id in ids if id is not None):
            if field and field['visibility'] == 'public':
                self.say(f"field {path}::{field['name']}: {self.type(field['inner']['struct_field'])}")

    def impl(self, path, item):
        of = item['inner']['impl'] if item else None
        if of is None or of['is_synthetic'] or of['blanket_impl']:
            return
        if of['trait']:
            trait = self.path(of['trait'])
            if trait != 'StructuralPartialEq':
                self.say(f'impl {trait} for {path}')
            return
        for id in of['items']:
            inner = self.item(id)
            if inner and inner['visibility'] == 'public':
                self.associated(path, inner)

    def associated(self, path, item):
        kind, of = next(iter(item['inner'].items()))
        path = f"{path}::{item['name']}"
        match kind:
            case 'function':
                self.function(path, item)
            case 'assoc_const':
                self.say(f"const {path}: {self.type(of['type'])}")
            case 'assoc_type':
                self.say(f"type {path}{': ' + self.bounds(of['bounds']) if of['bounds'] else ''}")

    def function(self, path, item):
        of = item['inner']['function']
        inputs = ', '.join(f'{name}: {self.type(t)}' for name, t in of['sig']['inputs'])
        output = f" -> {self.type(of['sig']['output'])}" if of['sig']['output'] else ''
        words = [word for word in ('const', 'unsafe', 'async') if of['header'][f'is_{word}']]
        self.say(f"{' '.join(words + ['fn'])} {path}{self.generics(of['generics'])}({inputs}){output}")


def main():
    stale = False
    for package, name in CRATES.items():
        library = Library(described(package))
        found = '\n'.join(sorted(library.lines, key=lambda line: (line.split('::', 1)[-1], line))) + '\n'
        file = ROOT / 'docs' / 'api' / f'{name}.txt'
        if '--store' in sys.argv[1:]:
            file.parent.mkdir(exist_ok=True)
            file.write_text(found)
            continue
        stored = file.read_text() if file.exists() else ''
        difference = list(difflib.unified_diff(stored.splitlines(), found.splitlines(), str(file.relative_to(ROOT)), 'now', lineterm='', n=0))
        if difference:
            stale = True
            print('\n'.join(difference))
    if stale:
        sys.exit('the public interface changed: where that is meant, python3 .ci/api.py --store')


main()
