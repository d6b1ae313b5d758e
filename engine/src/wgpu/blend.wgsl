// One workgroup per 16×16 pixels: the list of the tile they lie in, front to back.
//
//   α = min(0.99, opacity · 2^−(s² + t²))     s = q·(y − v)     t = p·(x − m − k·(y − anchor))
//   skipped where α < 1/255; a pixel is finished before the first that takes T·(1 − α) under 1e-4
//
// 256 entries at a time: each invocation looks at one and keeps it in shared memory where its blocks meet the group's; then
// every pixel goes through those that were kept, in order.

const SIDE: u32 = 16u;
const ALPHA_MIN: f32 = 0.003921569;
const ALPHA_MAX: f32 = 0.99;
const TRANSMITTANCE_MIN: f32 = 1e-4;
// 2^−126 is the least normal number; beyond that nothing is drawn.
const EXPONENT_MAX: f32 = 126.0;

struct Parameters {
    size: vec2<u32>,
    // Tiles across.
    columns: u32,
    unused: u32,
    // Planes of depth, alpha, transmittance and count; 0 where not wanted.
    planes: vec4<u32>,
    background: vec4<f32>,
}

struct Footprint {
    middle: vec2<f32>,
    row: vec2<f32>,
    anchor: f32,
    slope: f32,
    across: f32,
    down: f32,
    rgb: vec3<f32>,
    opacity: f32,
    depth: f32,
    reach: f32,
    // First block in the low half, last in the high one.
    columns: u32,
    rows: u32,
}

@group(0) @binding(0) var<uniform> parameters: Parameters;
@group(0) @binding(1) var<storage, read> footprints: array<Footprint>;
@group(0) @binding(2) var<storage, read> starts: array<u32>;
@group(0) @binding(3) var<storage, read> order: array<u32>;
@group(0) @binding(4) var<storage, read_write> image: array<f32>;

var<workgroup> place: array<vec4<f32>, 256>;
var<workgroup> form: array<vec4<f32>, 256>;
var<workgroup> paint: array<vec4<f32>, 256>;
var<workgroup> depths: array<f32, 256>;
// Which of the 256 were kept.
var<workgroup> kept: array<atomic<u32>, 8>;
// Pixels that are not finished.
var<workgroup> open: atomic<u32>;
var<workgroup> still_open: u32;

// Whether the span of blocks meets the group's four from `first`.
fn meets(span: u32, first: u32) -> bool {
    return (span & 0xffffu) < first + 4u && (span >> 16u) >= first;
}

fn put(plane: u32, at: u32, value: f32) {
    image[plane * parameters.size.x * parameters.size.y + at] = value;
}

@compute @workgroup_size(16, 16)
fn blend(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = group.xy * SIDE + local.xy;
    let inside = all(pixel < parameters.size);
    let x = f32(pixel.x);
    let y = f32(pixel.y);
    // Tiles are 64×32 pixels.
    let tile = group.y / 2u * parameters.columns + group.x / 4u;
    let end = starts[tile + 1u];

    var transmittance = 1.0;
    var rgb = vec3<f32>(0.0);
    var depth = 0.0;
    var count = 0u;
    var unfinished = inside;
    if unfinished {
        atomicAdd(&open, 1u);
    }
    for (var base = starts[tile]; base < end; base += 256u) {
        if lane < 8u {
            atomicStore(&kept[lane], 0u);
        }
        workgroupBarrier();
        if lane == 0u {
            still_open = atomicLoad(&open);
        }
        if workgroupUniformLoad(&still_open) == 0u {
            break;
        }
        if base + lane < end {
            let f = footprints[order[base + lane]];
            if meets(f.columns, group.x * 4u) && meets(f.rows, group.y * 4u) {
                place[lane] = vec4<f32>(f.middle, f.row);
                form[lane] = vec4<f32>(f.anchor, f.slope, f.across, f.down);
                paint[lane] = vec4<f32>(f.rgb, f.opacity);
                depths[lane] = f.depth;
                atomicOr(&kept[lane / 32u], 1u << (lane % 32u));
            }
        }
        workgroupBarrier();
        for (var word = 0u; word < 8u && unfinished; word++) {
            var bits = atomicLoad(&kept[word]);
            while bits != 0u {
                let i = word * 32u + firstTrailingBit(bits);
                bits &= bits - 1u;
                let at = place[i];
                let shape = form[i];
                let s = shape.w * ((y - at.z) - at.w);
                let t = shape.z * ((x - at.x) - (at.y + shape.y * (y - shape.x)));
                let alpha = min(paint[i].w * exp2(-min(s * s + t * t, EXPONENT_MAX)), ALPHA_MAX);
                if alpha >= ALPHA_MIN {
                    let weight = alpha * transmittance;
                    let left = transmittance - weight;
                    if left < TRANSMITTANCE_MIN {
                        unfinished = false;
                        atomicSub(&open, 1u);
                        break;
                    }
                    rgb += weight * paint[i].xyz;
                    depth += weight * depths[i];
                    count += 1u;
                    transmittance = left;
                }
            }
        }
        workgroupBarrier();
    }

    if inside {
        let at = pixel.y * parameters.size.x + pixel.x;
        let colour = rgb + transmittance * parameters.background.xyz;
        put(0u, at, colour.x);
        put(1u, at, colour.y);
        put(2u, at, colour.z);
        if parameters.planes.x != 0u {
            put(parameters.planes.x, at, depth);
        }
        if parameters.planes.y != 0u {
            put(parameters.planes.y, at, 1.0 - transmittance);
        }
        if parameters.planes.z != 0u {
            put(parameters.planes.z, at, transmittance);
        }
        if parameters.planes.w != 0u {
            put(parameters.planes.w, at, f32(count));
        }
    }
}
