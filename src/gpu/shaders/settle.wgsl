// Answers become tracks: light at every knot and its standard deviation, as the processor would take them.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> pixels: array<Pixel>;
@group(0) @binding(2) var<storage, read> states: array<State>;
@group(0) @binding(3) var<storage, read> whats: array<u32>;
@group(0) @binding(4) var<storage, read> work: array<f32>;
// Where the knots of each pixel begin.
@group(0) @binding(5) var<storage, read> offsets: array<u32>;
@group(0) @binding(6) var<storage, read> tracks: array<Track>;
@group(0) @binding(7) var<storage, read_write> light: array<f32>;
@group(0) @binding(8) var<storage, read_write> sigma: array<f32>;
// The brightest light of each pixel, before it was held.
@group(0) @binding(9) var<storage, read_write> brightest: array<f32>;

@compute @workgroup_size(64)
fn settle(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = id.x;
    if n >= params.end {
        return;
    }
    let track = tracks[n];
    var u = states[n].here.u0;
    var k = offsets[n];
    var is_first = true;
    var most = 0.0;
    var now = 0.0;
    for (var s = 0u; s < pixels[n].steps; s++) {
        let at = pixels[n].cell + s * LANES;
        let what = whats[at];
        if (what & SEGMENT) != 0u {
            if !is_first {
                u += work[SAVED * params.cells + at];
                k++;
            }
            is_first = false;
            now = exp(u) * track.ratio;
            most = max(most, now);
            light[k] = min(now, track.most);
        }
        if (what & LAST) != 0u && params.with_variance != 0u {
            var deviation = sqrt(max(work[CHANGE * params.cells + at], LEAST_VARIANCE)) * track.sigma_factor;
            if now > track.most {
                deviation = max(deviation, log(now / track.most));
            }
            sigma[k] = deviation;
        }
    }
    brightest[n] = most;
}
