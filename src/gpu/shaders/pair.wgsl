// REAL as the sum of two numbers of single precision, 48 bits together, where a card has no double precision.
//
// Source: T. J. Dekker, "A floating-point technique for extending the available precision" (1971). Rounding
// errors are hidden from compilers, which would find them to be zero.

fn lift(a: f32) -> vec2<f32> {
    return vec2(a, 0.0);
}
fn low(a: vec2<f32>) -> f32 {
    return a.x + a.y;
}
// Of a larger and a smaller number.
fn joined(a: f32, b: f32) -> vec2<f32> {
    let sum = opaque(a + b);
    return vec2(sum, b - opaque(sum - a));
}
fn add(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    let high = two_sum(a.x, b.x);
    let small = two_sum(a.y, b.y);
    let sum = joined(high.x, high.y + small.x);
    return joined(sum.x, sum.y + small.y);
}
fn sub(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    return add(a, -b);
}
// The upper half of the digits.
fn upper(a: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(a) & 0xfffff000u);
}
fn mul(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    let product = opaque(a.x * b.x);
    let a_high = upper(a.x);
    let a_low = opaque(a.x - a_high);
    let b_high = upper(b.x);
    let b_low = opaque(b.x - b_high);
    let error = ((opaque(a_high * b_high) - product) + a_high * b_low + a_low * b_high) + a_low * b_low;
    return joined(product, error + (a.x * b.y + a.y * b.x));
}
fn mad(a: vec2<f32>, b: vec2<f32>, c: vec2<f32>) -> vec2<f32> {
    return add(mul(a, b), c);
}
fn reciprocal(a: vec2<f32>) -> vec2<f32> {
    let first = lift(1.0 / a.x);
    let rest = sub(lift(1.0), mul(a, first));
    return add(first, mul(first, rest));
}
