// REAL in double precision, where the card has it.

fn lift(a: f32) -> f64 {
    return f64(a);
}
fn low(a: f64) -> f32 {
    return f32(a);
}
fn add(a: f64, b: f64) -> f64 {
    return a + b;
}
fn sub(a: f64, b: f64) -> f64 {
    return a - b;
}
fn mul(a: f64, b: f64) -> f64 {
    return a * b;
}
fn mad(a: f64, b: f64, c: f64) -> f64 {
    return a * b + c;
}
fn reciprocal(a: f64) -> f64 {
    return 1.0lf / a;
}
