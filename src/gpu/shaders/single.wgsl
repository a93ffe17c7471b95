// REAL in single precision.

fn lift(a: f32) -> f32 {
    return a;
}
fn low(a: f32) -> f32 {
    return a;
}
fn add(a: f32, b: f32) -> f32 {
    return a + b;
}
fn sub(a: f32, b: f32) -> f32 {
    return a - b;
}
fn mul(a: f32, b: f32) -> f32 {
    return a * b;
}
fn mad(a: f32, b: f32, c: f32) -> f32 {
    return a * b + c;
}
fn reciprocal(a: f32) -> f32 {
    return 1.0 / a;
}
