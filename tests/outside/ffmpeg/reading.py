"""reading.py STREAMSPLAT FFMPEG9 MODEL: videos of many kinds yield the right frames, times and colours with every ffmpeg.

Debian's ffmpeg makes the files. Each is read by that ffmpeg and by the one of PyPI's imageio-ffmpeg, with and without ffprobe on the path.
"""
import concurrent.futures
import json
import os
import shutil
import subprocess
import sys
import tempfile

STREAMSPLAT, NINE, MODEL = sys.argv[1:4]
WORK = tempfile.mkdtemp()
RED = (200, 40, 40)
SMALL, LARGE = '64x48', '1056x48'  # untagged files are BT.601 up to 1024 columns
FAILED = []


def programs():
    """Folders for the path: each ffmpeg with and without ffprobe."""
    found = {}
    for name, ffmpeg, probe in [('debian', shutil.which('ffmpeg'), True), ('debian alone', shutil.which('ffmpeg'), False),
                                ('pypi', NINE, True), ('pypi alone', NINE, False)]:
        folder = os.path.join(WORK, name.replace(' ', '-'))
        os.mkdir(folder)
        os.symlink(ffmpeg, os.path.join(folder, 'ffmpeg'))
        if probe:
            os.symlink(shutil.which('ffprobe'), os.path.join(folder, 'ffprobe'))
        found[name] = folder
    # Builds without libzimg.
    folder = os.path.join(WORK, 'slim')
    os.mkdir(folder)
    with open(os.path.join(folder, 'ffmpeg'), 'w') as file:
        file.write('#!/bin/sh\ncase "$*" in *zscale*) echo "[AVFilterGraph @ 0x1] [error] No such filter: \'zscale\'" >&2; exit 1 ;; esac\n'
                   f'exec {shutil.which("ffmpeg")} "$@"\n')
    os.chmod(os.path.join(folder, 'ffmpeg'), 0o755)
    found['slim'] = folder
    return found


PROGRAMS = programs()
READERS = [name for name in PROGRAMS if name != 'slim']


def path(name):
    return os.path.join(WORK, name)


def make(name, *arguments):
    """Makes a file with Debian's ffmpeg."""
    subprocess.run(['ffmpeg', '-v', 'error', '-y', *arguments, path(name)], check=True)
    return name


def lavfi(text):
    return ['-f', 'lavfi', '-i', text]


def red(size, frames=3):
    return lavfi(f'color=c=0x{"%02x%02x%02x" % RED}:s={size}:r=25:d={frames / 25},format=gbrp')


def moving(size=SMALL, frames=12, rate=25):
    return lavfi(f'testsrc2=s={size}:r={rate}:d={frames / rate},format=yuv420p')


def flat(size, colour, frames=3):
    """y4m of 16 bits in that colour: the reference for others."""
    width, height = map(int, size.split('x'))
    red, green, blue = (value / 255 for value in colour)
    y = 0.299 * red + 0.587 * green + 0.114 * blue
    if width > 1024:
        y = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    kr, kb = (0.2126, 0.0722) if width > 1024 else (0.299, 0.114)
    planes = [y * 65535, 32768 + 65535 * (blue - y) / (2 - 2 * kb), 32768 + 65535 * (red - y) / (2 - 2 * kr)]
    frame = b'FRAME\n' + b''.join(round(value).to_bytes(2, 'little') * (width * height) for value in planes)
    name = f'flat-{size}-{colour[0]}-{colour[1]}-{colour[2]}.y4m'
    if not os.path.exists(path(name)):
        # Several cases make the same file at once; it gets its name once it is complete.
        with tempfile.NamedTemporaryFile(dir=WORK, delete=False) as file:
            file.write(f'YUV4MPEG2 W{width} H{height} F25:1 C444p16 XCOLORRANGE=FULL\n'.encode() + frame * frames)
        os.replace(file.name, path(name))
    return name


def streamsplat(reader, *arguments):
    """Exit code, output and messages of the program with one of the ffmpegs."""
    environment = dict(os.environ, PATH=PROGRAMS[reader] + ':/nothing')
    done = subprocess.run([STREAMSPLAT, *arguments], env=environment, capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


def fail(what):
    FAILED.append(what)
    print('tests/outside/ffmpeg/reading.py:', what, file=sys.stderr)


def colours(name, size, colour=RED, most=1.5, readers=('debian', 'pypi alone')):
    """All samples of a video are within `most` steps of a colour."""
    for reader in readers:
        code, out, err = streamsplat(reader, 'compare', path(name), path(flat(size, colour)), '--max-abs', str(most))
        if code != 0:
            fail(f'{name} by {reader}: not {colour} within {most}: {out.strip()} {err.strip()}')


def reading(name, times, saying=(), size=None, code=0, readers=READERS, extra=()):
    """A run has frames at these times, prints these lines, and has the same result with every ffmpeg. With `times` None any times are accepted."""
    first = None
    for reader in readers:
        out = tempfile.mkdtemp(dir=WORK)
        found, _, err = streamsplat(reader, 'run', path(name), '--out', os.path.join(out, 'o'), '--overwrite', '--model', MODEL,
                                    '--gap', '1', '--emit', 'scene', *extra)
        if found != code:
            fail(f'{name} by {reader}: exit code {found}, expected {code}: {err.strip()}')
            continue
        for line in saying:
            if line not in err:
                fail(f'{name} by {reader}: expected a line with: {line}; found {err.strip()}')
        record = json.load(open(os.path.join(out, 'o', 'run.json')))
        scene = json.load(open(os.path.join(out, 'o', 'scene', 'scene.json')))
        shown = [interval['end'] for interval in scene['intervals']]
        if times is not None and (len(shown) != len(times) or any(abs(a - b) > 2e-6 for a, b in zip(shown, times))):
            fail(f'{name} by {reader}: expected frames at {times}, found {shown}')
        if size and record['input']['size'] != size:
            fail(f'{name} by {reader}: expected {size}, found {record["input"]["size"]}')
        if code and not record['input'].get('damage'):
            fail(f'{name} by {reader}: no word of the damage in run.json')
        here = (shown, record['input']['blake3'], record['input']['fps'])
        first = first or (reader, here)
        if here != first[1]:
            fail(f'{name}: {reader} and {first[0]} read other frames or times')
        shutil.rmtree(out)


def refused(name, saying, readers=READERS, extra=()):
    """A run that is refused in one line."""
    for reader in readers:
        code, _, err = streamsplat(reader, 'run', path(name), '--out', path('refused'), '--model', MODEL, *extra)
        if code != 1 or saying not in err or len(err.strip().splitlines()) != 1:
            fail(f'{name} by {reader}: expected one line with: {saying}; found exit code {code}, {err.strip()}')


def even(frames, rate=25):
    return [i / rate for i in range(frames)]


def colour_cases():
    """Tags of colour, for every size."""
    lossless = ['-c:v', 'libx264', '-qp', '0']
    for size in (SMALL, LARGE):
        for matrix, tag in [('bt709', 'bt709'), ('smpte170m', 'smpte170m'), ('bt470bg', 'bt470bg'), ('fcc', 'fcc'),
                            ('smpte240m', 'smpte240m'), ('bt2020', 'bt2020nc')]:
            for range_, full in [('tv', 'limited'), ('pc', 'full')]:
                name = make(f'{tag}-{range_}-{size}.mp4', *red(size), '-vf',
                            f'scale=out_color_matrix={matrix}:out_range={full},format=yuv444p', *lossless, '-colorspace', tag,
                            '-color_range', range_)
                yield lambda name=name, size=size: colours(name, size)
        # Wide primaries with their matrix, by the curve of a display (BT.1886).
        for tag, transfer in [('2020', 'bt2020-10'), ('smpte432', 'bt709')]:
            matrix = '2020_ncl' if tag == '2020' else '709'
            name = make(f'wide-{tag}-{size}.mp4', *red(size), '-vf',
                        f'zscale=min=gbr:rin=pc:p={tag}:m={matrix}:t={transfer}:pin=709:tin=709:r=tv,format=yuv444p10', *lossless)
            yield lambda name=name, size=size: colours(name, size)
        for curve in ('smpte2084', 'arib-std-b67'):
            name = make(f'{curve}-{size}.mp4', *red(size, 26), '-vf',
                        f'zscale=min=gbr:rin=pc:tin=709:pin=709:t=linear:p=709:m=gbr:npl=100,format=gbrpf32le,zscale=min=gbr:tin=linear:pin=709:t={curve}:p=2020:m=2020_ncl:npl=100:r=tv,format=yuv444p10',
                        *lossless, '-frames:v', '3')
            yield lambda name=name, size=size: colours(name, size)
            # White of 100 cd/m² must not become brighter.
            name = make(f'white-{curve}-{size}.mp4', *lavfi(f'color=c=white:s={size}:r=25:d=0.12,format=gbrp'), '-vf',
                        f'format=gbrpf32le,zscale=min=gbr:rin=pc:pin=709:tin=709:npl=100:m=2020_ncl:r=tv:p=2020:t={curve},format=yuv444p10', *lossless)
            yield lambda name=name, size=size: colours(name, size, (255, 255, 255))
        # Files without Y'CbCr are exact.
        for name, more in [('rgb.mp4', ['-c:v', 'libx264rgb', '-qp', '0']), ('png.mov', ['-c:v', 'png', '-pix_fmt', 'rgb24']),
                           ('ffv1.mkv', ['-c:v', 'ffv1', '-pix_fmt', 'gbrp']), ('ten.mkv', ['-c:v', 'ffv1', '-pix_fmt', 'gbrp10le']),
                           ('sixteen.mkv', ['-c:v', 'ffv1', '-pix_fmt', 'gbrp16le']), ('qtrle.mov', ['-c:v', 'qtrle']),
                           ('gif.gif', ['-vf', 'split[a][b];[a]palettegen=reserve_transparent=0[p];[b][p]paletteuse=dither=none']), ('apng.apng', ['-f', 'apng', '-plays', '0'])]:
            name = make(f'{size}-{name}', *red(size), *more)
            # ffmpeg extends eight bits by shifting, which is at most 0.8 less.
            most = 1 if name.endswith(('ten.mkv', 'sixteen.mkv')) else 0.01
            yield lambda name=name, size=size, most=most: colours(name, size, most=most)
        name = make(f'mjpeg-{size}.avi', *red(size), '-c:v', 'mjpeg', '-q:v', '1', '-pix_fmt', 'yuvj444p')
        yield lambda name=name, size=size: colours(name, size)
    # Untagged, by size; with --matrix, by that.
    for size, matrix in [(SMALL, 'bt601'), (LARGE, 'bt709')]:
        name = make(f'untagged-{size}.avi', *red(size), '-vf', f'scale=out_color_matrix={matrix}:out_range=limited,format=yuv420p',
                    '-c:v', 'rawvideo')
        yield lambda name=name, size=size: colours(name, size)
    # Formats that y4m does not have; nut has no tags.
    for format_ in ('nv12', 'yuyv422', 'uyvy422', 'yuv440p', 'yuv422p10le', 'yuv420p16le'):
        name = make(f'{format_}.nut', *red(SMALL), '-vf', f'scale=out_color_matrix=bt601:out_range=limited,format={format_}', '-c:v', 'rawvideo')
        yield lambda name=name: colours(name, SMALL)
    for level in (64, 250, 16):
        grey = lavfi(f'color=s={SMALL}:r=25:d=0.12,format=gray,geq=lum={level}')
        for name, more in [('raw.avi', ['-c:v', 'rawvideo']), ('ffv1.mkv', ['-c:v', 'ffv1']), ('deep.mkv', ['-c:v', 'ffv1', '-pix_fmt', 'gray16le'])]:
            name = make(f'grey-{level}-{name}', *grey, *more)
            yield lambda name=name, level=level: colours(name, SMALL, (level,) * 3, 0.51)
    yield lambda: refused('smpte2084-' + SMALL + '.mp4', 'need the filter zscale, which this ffmpeg was built without', ['slim'])


def time_cases():
    """Every frame once, at its own time."""
    x264 = ['-c:v', 'libx264', '-bf', '0']
    make('even.mp4', *moving(), *x264)
    make('even.mkv', *moving(rate=24), *x264)
    make('ntsc.webm', *moving(rate=30), '-c:v', 'libvpx')
    yield lambda: reading('even.mp4', even(12))
    yield lambda: reading('even.mkv', even(12, 24))
    yield lambda: reading('ntsc.webm', even(12, 30))
    kept = [i for i in range(12) if i % 3 != 1]
    for name in ('uneven.mp4', 'uneven.mkv'):
        make(name, *moving(), '-vf', "select='not(eq(mod(n,3),1))'", '-fps_mode', 'passthrough', *x264)
        yield lambda name=name: reading(name, [i / 25 for i in kept])
    # Like recordings of browsers: no default duration, milliseconds.
    make('recorder.webm', *moving(), '-vf', "select='not(eq(mod(n,3),1))'", '-fps_mode', 'passthrough', '-c:v', 'libvpx')
    data = open(path('recorder.webm'), 'rb').read()
    at = data.index(b'\x23\xe3\x83\x84')
    open(path('recorder.webm'), 'wb').write(data[:at] + b'\xec\x86' + bytes(6) + data[at + 8:])
    yield lambda: reading('recorder.webm', [i / 25 for i in kept])
    # A picture that starts after its sound.
    make('six.mp4', *moving(frames=6), *x264)
    make('late.mp4', '-f', 'lavfi', '-i', 'sine=d=1.4', '-itsoffset', '1', '-i', path('six.mp4'), '-map', '0', '-map', '1', '-c:a', 'aac', '-c:v', 'copy')
    yield lambda: reading('late.mp4', even(6))
    # An edit list that hides the first frames; first frames without time stamps; two frames at one time.
    make('long.mp4', *moving(frames=20), *x264, '-g', '20')
    make('edited.mp4', '-ss', '0.2', '-i', path('long.mp4'), '-c', 'copy')
    yield lambda: reading('edited.mp4', even(15))
    make('negative.mkv', '-i', path('even.mp4'), '-c', 'copy', '-output_ts_offset', '-0.2', '-avoid_negative_ts', 'disabled')
    yield lambda: reading('negative.mkv', even(12))
    make('twice.mkv', *moving(frames=5), *x264, '-bsf:v', 'setts=ts=TS-if(eq(N\\,2)\\,40\\,0)')
    yield lambda: reading('twice.mkv', [0, 0.04, 0.041, 0.12, 0.16], ['frames whose time is not after that of the frame before: 1;'])
    # Frames stored in another order than displayed.
    make('reordered.mp4', *moving(frames=12), '-c:v', 'libx264', '-bf', '3')
    yield lambda: reading('reordered.mp4', even(12))
    make('anim.gif', *moving(frames=6, rate=10))
    yield lambda: reading('anim.gif', even(6, 10))


def stream_cases():
    """The stream that moves."""
    x264 = ['-c:v', 'libx264', '-bf', '0']
    make('cover.png', *red('32x32', 1), '-frames:v', '1')
    make('even5.mp4', *moving(frames=5), *x264)
    cover = ['-i', path('cover.png')]
    make('cover-last.mp4', '-i', path('even5.mp4'), *cover, '-map', '0', '-map', '1', '-c', 'copy', '-disposition:v:1', 'attached_pic')
    make('cover-first.mkv', *cover, '-i', path('even5.mp4'), '-map', '0', '-map', '1', '-c', 'copy', '-disposition:v:0', '0', '-disposition:v:1', 'default')
    make('cover-default.mkv', *cover, '-i', path('even5.mp4'), '-map', '0', '-map', '1', '-c', 'copy', '-disposition:v:0', 'default', '-disposition:v:1', '0')
    yield lambda: reading('cover-last.mp4', even(5), ['the cover picture 0:1 (png, 32×32) is left out'], [64, 48])
    yield lambda: reading('cover-first.mkv', even(5), ['the still picture 0:0 (png, 32×32) is left out'], [64, 48])
    yield lambda: reading('cover-default.mkv', even(5), ['the still picture 0:0 (png, 32×32) is left out'], [64, 48])
    make('song.mp3', '-f', 'lavfi', '-i', 'sine=d=0.5', *cover, '-map', '0', '-map', '1', '-c:v', 'copy', '-disposition:v', 'attached_pic')
    yield lambda: refused('song.mp3', 'found sound alone (MP3)')
    make('song.ogg', '-f', 'lavfi', '-i', 'sine=d=0.5', '-c:a', 'libvorbis')
    yield lambda: refused('song.ogg', 'found sound alone')
    # The default stream is preferred to the larger one, and that to the first.
    two = [*moving('96x64', 5), *moving('64x48', 5), '-map', '0', '-map', '1', *x264]
    make('second.mkv', *two, '-disposition:v:0', '0', '-disposition:v:1', 'default')
    make('programs.ts', *moving('64x48', 5), *moving('96x64', 5), '-map', '0', '-map', '1', *x264, '-program', 'program_num=1:st=0', '-program',
         'program_num=2:st=1')
    yield lambda: reading('second.mkv', even(5), ['the video stream 0:0 (h264, 96×64) is left out'], [64, 48])
    yield lambda: reading('programs.ts', even(5), ['the video stream 0:0 (h264, 64×48) is left out'], [96, 64])
    # Further sound and subtitles, alpha and transparent parts, and a stream without a container.
    open(path('words.srt'), 'w').write('1\n00:00:00,000 --> 00:00:00,100\nWords\n')
    sound = ['-f', 'lavfi', '-i', 'sine=d=0.2']
    make('two-sounds.mkv', *moving(frames=5), *sound, *sound, '-i', path('words.srt'), '-map', '0', '-map', '1', '-map', '2', '-map', '3', *x264)
    yield lambda: reading('two-sounds.mkv', even(5), ['the sound track 0:2 is left out', 'the subtitles 0:3 are left out'])
    half = ['-vf', 'format=yuva420p,colorchannelmixer=aa=0.5']
    make('alpha.webm', *moving(frames=5), *half, '-c:v', 'libvpx-vp9', '-pix_fmt', 'yuva420p')
    yield lambda: reading('alpha.webm', even(5), ['the alpha plane is left out'])
    hole = "format=rgba,geq=r='r(X,Y)':g='g(X,Y)':b='b(X,Y)':a='255*gt(X,20)',split[a][b];[a]palettegen=reserve_transparent=1[p];[b][p]paletteuse"
    make('hole.gif', *lavfi(f'testsrc2=s={SMALL}:r=10:d=0.3'), '-vf', hole)
    yield lambda: reading('hole.gif', even(3, 10), ['transparent parts of the GIF are taken as white'])
    make('raw.mjpeg', *moving(frames=5), '-pix_fmt', 'yuvj420p')
    yield lambda: reading('raw.mjpeg', even(5), ['a raw stream need not state a rate'])
    make('anim.avif', *moving(frames=5), '-c:v', 'libaom-av1', '-cpu-used', '8')
    yield lambda: reading('anim.avif', even(5), size=[64, 48])


def shape_cases():
    """Fields and pixels."""
    fields = '-vf', 'tinterlace=interleave_top,setfield=tff'
    make('fields.mp4', *moving(frames=12, rate=50), *fields, '-c:v', 'libx264', '-flags', '+ilme+ildct', '-bf', '0')
    make('dv.avi', *lavfi('testsrc2=s=720x576:r=50:d=0.16,format=yuv420p'), '-vf', 'tinterlace=interleave_bottom,setfield=bff', '-c:v', 'dvvideo')
    yield lambda: reading('fields.mp4', None, ['interlaced frames were deinterlaced'])
    yield lambda: reading('dv.avi', None, ['interlaced frames were deinterlaced'])
    # A message of a filter that turns pictures has no line end.
    make('upright.mp4', *moving(), '-c:v', 'libx264', '-bf', '0')
    make('turned.mp4', '-i', path('upright.mp4'), '-c', 'copy', '-metadata:s:v', 'rotate=10')
    yield lambda: reading('turned.mp4', even(12))
    # Properties that change within the video.
    for name, more in [('first', ['-colorspace', 'bt709']), ('second', ['-colorspace', 'smpte170m', '-output_ts_offset', '1'])]:
        make(f'{name}.ts', *moving(frames=5), '-c:v', 'libx264', '-bf', '0', *more)
    open(path('changes.ts'), 'wb').write(open(path('first.ts'), 'rb').read() + open(path('second.ts'), 'rb').read())
    # Newer versions convert the frames.
    for readers in (READERS[:2], READERS[2:]):
        yield lambda readers=readers: reading('changes.ts', None, ['from frame 5 on: the matrix smpte170m instead of bt709;'], readers=readers)
    make('wide.mp4', *moving(), '-vf', 'setsar=4/3', '-c:v', 'libx264', '-bf', '0')
    yield lambda: reading('wide.mp4', even(12), ['pixels of 4:3 were made square'], [85, 48])
    make('wide.y4m', *moving(frames=3), '-vf', 'setsar=4/3')
    yield lambda: reading('wide.y4m', even(3), ['pixels of 4:3 were made square'], [85, 48], readers=['debian'])
    make('fields.y4m', *moving(frames=6, rate=50), *fields)
    yield lambda: reading('fields.y4m', None, ['the stream is interlaced'], readers=['debian'])
    make('grey.y4m', *lavfi(f'color=s={SMALL}:r=25:d=0.12,format=gray,geq=lum=64'))
    yield lambda: colours('grey.y4m', SMALL, (64, 64, 64), 0.01, ['debian'])
    # The option overrides the size.
    make('bt709.y4m', *red(SMALL), '-vf', 'scale=out_color_matrix=bt709,format=yuv444p', '-strict', '-1')
    make('bt709.mkv', *red(SMALL), '-c:v', 'ffv1', '-vf', 'scale=out_color_matrix=bt709,format=yuv444p')
    yield lambda: matrix('bt709.y4m')
    yield lambda: matrix('bt709.mkv')


def matrix(name):
    """With --matrix an untagged file equals one tagged with that matrix."""
    digests = []
    make('tagged-' + name + '.mkv', *red(SMALL), '-c:v', 'ffv1', '-vf', 'scale=out_color_matrix=bt709,format=yuv444p', '-colorspace', 'bt709')
    for file, extra in [(name, ['--matrix', 'bt709']), ('tagged-' + name + '.mkv', [])]:
        out = tempfile.mkdtemp(dir=WORK)
        streamsplat('debian', 'run', path(file), '--out', os.path.join(out, 'o'), '--model', MODEL, *extra)
        digests.append(json.load(open(os.path.join(out, 'o', 'run.json')))['input']['blake3'])
    if digests[0] != digests[1]:
        fail(f'{name}: --matrix bt709 reads other samples than the tag')


def damage_cases():
    """Frames before the damage are kept, and one line reports it."""
    source = [*moving(frames=30), '-c:v', 'libx264', '-bf', '0', '-g', '10']
    for name, more in [('whole.mp4', ['-movflags', '+faststart']), ('whole.mkv', [])]:
        make(name, *source, *more)
        data = open(path(name), 'rb').read()
        cut, spoilt = name.replace('whole', 'cut'), name.replace('whole', 'spoilt')
        open(path(cut), 'wb').write(data[:len(data) * 6 // 10])
        middle = len(data) * 6 // 10
        open(path(spoilt), 'wb').write(data[:middle] + bytes(range(1, 256)) * 2 + data[middle + 510:])
        yield lambda cut=cut: reading(cut, None, [f'{cut}: damaged: ', ' frames of about 30 announced were read: '], code=1)
        yield lambda spoilt=spoilt: reading(spoilt, None, [f'{spoilt}: damaged: '], code=1, readers=['debian', 'debian alone'])
    # Cut right before a packet: only the container's declared length shows that something is missing.
    for name, more in [('between.mp4', ['-c:v', 'libx264', '-bf', '0', '-movflags', '+faststart']), ('between.webm', ['-c:v', 'libvpx']),
                       ('between.avi', ['-c:v', 'mjpeg']), ('between.flv', ['-c:v', 'flv1']), ('between.gif', []), ('between.ogv', ['-c:v', 'libtheora'])]:
        make(name, *moving(frames=20), *more)
        places = subprocess.run(['ffprobe', '-v', 'error', '-show_entries', 'packet=pos', '-of', 'csv=p=0', path(name)], capture_output=True, text=True, check=True)
        places = [int(place.strip(',')) for place in places.stdout.split() if place.strip(',').isdigit()]
        with open(path(name), 'rb') as file:
            data = file.read()
        at = sorted(places)[9] if name != 'between.gif' else len(data) * 9 // 10
        with open(path('cut-' + name), 'wb') as file:
            file.write(data[:at])
        # Versions of ffmpeg differ in Theora's samples, and in decoding a part of a GIF's frame.
        alike = [READERS[:2], READERS[2:]] if name in ('between.ogv', 'between.gif') else [READERS]
        for readers in alike:
            yield lambda name=name, readers=readers: reading(name, None, readers=readers)
            yield lambda name=name, readers=readers: reading('cut-' + name, None, [f'cut-{name}: damaged: '], code=1, readers=readers)
    with open(path('notes.txt'), 'w') as file:
        file.write('hello world\n' * 50)
    yield lambda: refused('notes.txt', 'found a text file')
    make('whole.y4m', *moving(frames=4))
    data = open(path('whole.y4m'), 'rb').read()
    open(path('cut.y4m'), 'wb').write(data[:-100])
    yield lambda: reading('cut.y4m', even(3), ['cut.y4m: frame 3 ends early'], code=1, readers=['debian'])
    # Parts of a transport stream that were joined are not damaged.
    make('one.ts', *moving(frames=5), '-c:v', 'libx264', '-bf', '0')
    make('two.ts', *moving(frames=5), '-c:v', 'libx264', '-bf', '0', '-output_ts_offset', '1')
    open(path('joined.ts'), 'wb').write(open(path('one.ts'), 'rb').read() + open(path('two.ts'), 'rb').read())
    yield lambda: reading('joined.ts', even(5) + [1 + time for time in even(5)])


def main():
    wanted = sys.argv[4:]
    groups = [colour_cases, time_cases, stream_cases, shape_cases, damage_cases]
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        for group in groups:
            if not wanted or group.__name__ in wanted:
                for done in [pool.submit(case) for case in group()]:
                    done.result()
    shutil.rmtree(WORK)
    sys.exit(len(FAILED) > 0)


main()
