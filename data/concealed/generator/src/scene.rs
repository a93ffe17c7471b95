//! What the sensor looks at: fourteen families of moving light and a star, each given by a formula in place
//! and time.
//!
//! A family gives a pattern `s(x, y, t)` of about -1 to 1; the light is
//! `ln i = mean + contrast s + ln(1 + depth sin(2 pi f t))`. Time inside a family runs `pace` times as fast
//! as the clock, which is how a scene is made to fire as many events as wanted. The families of the plan
//! `field` are in `views`.

use crate::random::Random;
use crate::star::Star;
use crate::texture::Texture;
use crate::views::View;
use std::f64::consts::PI;

/// Where light is evaluated: pixel (0, 0) lies at (`left`, `top`) in the scene.
#[derive(Clone, Copy, Debug)]
pub struct Grid {
    pub left: f64,
    pub top: f64,
    pub columns: usize,
    pub rows: usize,
}

/// Light over the array and time.
#[derive(Clone, Debug)]
pub struct Scene {
    pub family: Family,
    /// `ln` of the light, photocurrent units, where the pattern is 0.
    pub mean: f64,
    /// Change of `ln i` from the pattern's 0 to 1.
    pub contrast: f64,
    pub pace: f64,
    /// Depth, frequency (Hz) and phase of a lamp that flickers.
    pub flicker: Option<[f64; 3]>,
}

/// A body that moves straight and is reflected at the edges of a box around the array.
#[derive(Clone, Debug)]
pub struct Body {
    place: [f64; 2],
    velocity: [f64; 2],
    radius: f64,
    level: f64,
}

/// One family with its drawn parameters; lengths in pixels, times in seconds of the family's clock.
#[derive(Clone, Debug)]
pub enum Family {
    /// A texture drifts.
    Drift { texture: Texture, velocity: [f64; 2] },
    /// A texture grows and shrinks about a centre, as on going forth and back.
    Zoom { texture: Texture, centre: [f64; 2], frequency: f64, phase: f64 },
    /// A texture turns about a centre.
    Spin { texture: Texture, centre: [f64; 2], omega: f64 },
    /// A textured disc turns before a texture that stands still or drifts slowly.
    Turntable { disc: Texture, ground: Texture, centre: [f64; 2], radius: f64, omega: f64, drift: f64 },
    /// A textured patch bounces over a texture.
    Patch { patch: Texture, ground: Texture, body: Body, drift: f64 },
    /// Dark and bright sectors turn.
    Spokes { count: f64, centre: [f64; 2], omega: f64, width: f64, ground: Texture },
    /// Bars of several brightnesses pass in several directions.
    Bars { bars: Vec<[f64; 5]>, width: f64 },
    /// Discs bounce over a still texture.
    Discs { bodies: Vec<Body>, width: f64, ground: Texture, share: f64 },
    /// Rings run outwards, brighter and darker by a texture.
    Rings { centre: [f64; 2], wavelength: f64, speed: f64, texture: Texture },
    /// A texture is shaken, as by a hand.
    Shake { texture: Texture, reach: [f64; 2], frequency: [f64; 2], phase: [f64; 2] },
    /// Rows move at different speeds, as near and far things seen from a train.
    Shear { texture: Texture, speed: f64, spread: f64, period: f64 },
    /// A chessboard with soft edges turns and drifts.
    Chess { cell: f64, omega: f64, velocity: [f64; 2], width: f64, ground: Texture },
    /// Soft spots swing about.
    Spots { spots: Vec<[f64; 8]>, ground: Texture },
    /// Waves cross each other.
    Waves { waves: Vec<[f64; 4]> },
    /// The star of a known target: its pattern is the logarithm of its reflectance.
    Star(Star),
    /// One of the ten families of the plan `field`.
    View(Box<View>),
    /// The whole field brightens at a constant pace (1/s): its events are known in closed form.
    #[cfg(test)]
    Ramp { slope: f64 },
}

/// From -1 to 1 within about `width` of zero, algebraic (no table, no platform's function).
fn soft(d: f64, width: f64) -> f64 {
    d / libm::sqrt(width * width + d * d)
}

/// A texture's value, kept within -1 and 1.
fn bounded(v: f64) -> f64 {
    soft(v, 1.0)
}

/// A triangle wave in `low` .. `high`: where a body is that is reflected at both.
fn reflected(at: f64, low: f64, high: f64) -> f64 {
    let span = high - low;
    let turn = (at - low).rem_euclid(2.0 * span);
    low + if turn > span { 2.0 * span - turn } else { turn }
}

impl Body {
    /// The body's centre; the box reaches `beyond` pixels over the array.
    fn at(&self, t: f64, width: f64, height: f64, beyond: f64) -> [f64; 2] {
        let along =
            |k: usize, far: f64| reflected(self.place[k] + self.velocity[k] * t, -beyond, far + beyond);
        [along(0, width), along(1, height)]
    }
}

impl Family {
    /// The names of all families, as answers state them.
    pub const NAMES: [&'static str; 14] = [
        "drift",
        "zoom",
        "spin",
        "turntable",
        "patch",
        "spokes",
        "bars",
        "discs",
        "rings",
        "shake",
        "shear",
        "chess",
        "spots",
        "waves",
    ];

    /// Draws a family by name for an array of `width` x `height` pixels. `edge` is the softness of drawn
    /// edges, pixels.
    pub fn draw(name: &str, random: &mut Random, width: f64, height: f64, edge: f64) -> Self {
        let centre = [width * random.between(0.3, 0.7), height * random.between(0.3, 0.7)];
        let angle = random.between(0.0, 2.0 * PI);
        let heading = |speed: f64| [speed * libm::cos(angle), speed * libm::sin(angle)];
        let (finest, slope) = (random.between(5.0, 9.0), random.between(1.2, 1.8));
        let texture = |random: &mut Random| Texture::draw(random, finest, slope, 160);
        match name {
            "drift" => Self::Drift { texture: texture(random), velocity: heading(300.0) },
            "zoom" => Self::Zoom {
                texture: texture(random),
                centre,
                frequency: 8.0,
                phase: random.between(0.0, 2.0 * PI),
            },
            "spin" => Self::Spin { texture: texture(random), centre, omega: random.sign() * 14.0 },
            "turntable" => Self::Turntable {
                disc: texture(random),
                ground: texture(random),
                centre,
                radius: height * random.between(0.38, 0.48),
                omega: random.sign() * 25.0,
                drift: random.between(0.0, 60.0),
            },
            "patch" => {
                let body = Body {
                    place: centre,
                    velocity: heading(500.0),
                    radius: height * random.between(0.25, 0.4),
                    level: 0.0,
                };
                Self::Patch {
                    patch: texture(random),
                    ground: texture(random),
                    body,
                    drift: random.between(50.0, 200.0),
                }
            }
            "spokes" => Self::Spokes {
                count: (3 + random.below(5)) as f64,
                centre,
                omega: random.sign() * 12.0,
                width: edge,
                ground: texture(random),
            },
            "bars" => {
                let bar = |random: &mut Random| {
                    let speed = random.sign() * random.between(200.0, 600.0);
                    [
                        random.between(0.0, PI),
                        speed,
                        random.between(2.0, 8.0),
                        random.between(0.0, 110.0),
                        random.sign() * random.between(0.5, 1.0),
                    ]
                };
                Self::Bars { bars: (0..5).map(|_| bar(random)).collect(), width: edge }
            }
            "discs" | "few_discs" => {
                let few = name == "few_discs";
                let mut body = || {
                    let angle = random.between(0.0, 2.0 * PI);
                    let speed = random.between(300.0, 900.0);
                    let velocity = [speed * libm::cos(angle), speed * libm::sin(angle)];
                    let place = [random.between(0.0, width), random.between(0.0, height)];
                    Body {
                        place,
                        velocity,
                        radius: random.between(3.0, 9.0),
                        level: random.sign() * random.between(0.6, 1.1),
                    }
                };
                let bodies = (0..if few { 2 } else { 8 }).map(|_| body()).collect();
                Self::Discs {
                    bodies,
                    width: edge,
                    ground: texture(random),
                    share: if few { 0.5 } else { 0.3 },
                }
            }
            "rings" => Self::Rings {
                centre,
                wavelength: random.between(14.0, 26.0),
                speed: random.sign() * 350.0,
                texture: texture(random),
            },
            "shake" => Self::Shake {
                texture: texture(random),
                reach: [random.between(3.0, 7.0), random.between(2.0, 6.0)],
                frequency: [random.between(8.0, 15.0), random.between(12.0, 22.0)],
                phase: [random.between(0.0, 2.0 * PI), random.between(0.0, 2.0 * PI)],
            },
            "shear" => Self::Shear {
                texture: texture(random),
                speed: random.sign() * 250.0,
                spread: random.between(150.0, 350.0),
                period: random.between(30.0, 60.0),
            },
            "chess" => Self::Chess {
                cell: random.between(9.0, 15.0),
                omega: random.sign() * random.between(3.0, 8.0),
                velocity: heading(250.0),
                width: edge,
                ground: texture(random),
            },
            "spots" => {
                let mut spot = || {
                    let (x, y) = (random.between(0.0, width), random.between(0.0, height));
                    let (rx, ry) = (random.between(8.0, 25.0), random.between(8.0, 20.0));
                    let (fx, fy) = (random.between(3.0, 9.0), random.between(3.0, 9.0));
                    [x, y, rx, ry, fx, fy, random.between(2.5, 6.0), random.sign() * random.between(0.6, 1.2)]
                };
                let spots = (0..9).map(|_| spot()).collect();
                Self::Spots { spots, ground: texture(random) }
            }
            _ => {
                let mut wave = || {
                    let (angle, k) = (random.between(0.0, 2.0 * PI), 2.0 * PI / random.between(9.0, 28.0));
                    [
                        k * libm::cos(angle),
                        k * libm::sin(angle),
                        2.0 * PI * random.between(8.0, 30.0),
                        random.between(0.0, 2.0 * PI),
                    ]
                };
                Self::Waves { waves: (0..6).map(|_| wave()).collect() }
            }
        }
    }

    /// The pattern over `grid` at the family's time `t`, row by row; the array itself is `width` x `height`.
    fn pattern(&self, t: f64, grid: &Grid, width: f64, height: f64, out: &mut [f64]) {
        let each = |out: &mut [f64], value: &dyn Fn(f64, f64) -> f64| {
            for (row, values) in out.chunks_exact_mut(grid.columns).enumerate() {
                let y = grid.top + row as f64;
                for (column, v) in values.iter_mut().enumerate() {
                    *v = value(grid.left + column as f64, y);
                }
            }
        };
        let turned = |angle: f64, centre: &[f64; 2]| {
            let (sin, cos, [cx, cy]) = (libm::sin(angle), libm::cos(angle), *centre);
            move |x: f64, y: f64| (cx + cos * (x - cx) - sin * (y - cy), cy + sin * (x - cx) + cos * (y - cy))
        };
        let middle = [0.5 * width, 0.5 * height];
        match self {
            Self::Drift { texture, velocity } => {
                each(out, &|x, y| bounded(texture.at(x - velocity[0] * t, y - velocity[1] * t)))
            }
            Self::Zoom { texture, centre, frequency, phase } => {
                let scale = libm::exp(0.35 * libm::sin(2.0 * PI * frequency * t + phase));
                each(out, &|x, y| {
                    bounded(
                        texture.at(centre[0] + (x - centre[0]) * scale, centre[1] + (y - centre[1]) * scale),
                    )
                });
            }
            Self::Spin { texture, centre, omega } => {
                let turn = turned(-omega * t, centre);
                each(out, &|x, y| {
                    let (x, y) = turn(x, y);
                    bounded(texture.at(x, y))
                });
            }
            Self::Turntable { disc, ground, centre, radius, omega, drift } => {
                let turn = turned(-omega * t, centre);
                each(out, &|x, y| {
                    let distance =
                        libm::sqrt((x - centre[0]) * (x - centre[0]) + (y - centre[1]) * (y - centre[1]));
                    let inside = 0.5 + 0.5 * soft(radius - distance, 0.8);
                    let (u, v) = turn(x, y);
                    inside * bounded(disc.at(u, v)) + (1.0 - inside) * bounded(ground.at(x - drift * t, y))
                });
            }
            Self::Patch { patch, ground, body, drift } => {
                let [px, py] = body.at(t, width, height, 4.0);
                each(out, &|x, y| {
                    let (dx, dy) = (x - px, y - py);
                    let inside = (0.5 + 0.5 * soft(body.radius - dx.abs(), 0.8))
                        * (0.5 + 0.5 * soft(body.radius - dy.abs(), 0.8));
                    inside * bounded(patch.at(dx, dy) + 0.5)
                        + (1.0 - inside) * bounded(ground.at(x, y - drift * t))
                });
            }
            Self::Spokes { count, centre, omega, width, ground } => each(out, &|x, y| {
                let (dx, dy) = (x - centre[0], y - centre[1]);
                let r = libm::sqrt(dx * dx + dy * dy);
                // Times r / count: the distance to the nearest edge in pixels, so that edges are equally soft
                // everywhere.
                let d = libm::sin(count * (libm::atan2(dy, dx) - omega * t)) * r / count;
                0.85 * soft(d, *width) + 0.15 * bounded(ground.at(x, y))
            }),
            Self::Bars { bars, width } => {
                // Bars come from beyond one corner and leave beyond the other.
                let far = libm::sqrt(middle[0] * middle[0] + middle[1] * middle[1]);
                let ways: Vec<[f64; 5]> = bars
                    .iter()
                    .map(|[angle, speed, half, start, level]| {
                        [
                            libm::cos(*angle),
                            libm::sin(*angle),
                            (start + speed * t).rem_euclid(2.0 * far + 40.0) - far,
                            *half,
                            *level,
                        ]
                    })
                    .collect();
                each(out, &|x, y| {
                    let mut sum = 0.0;
                    for [cos, sin, at, half, level] in &ways {
                        let d = (x - middle[0]) * cos + (y - middle[1]) * sin + 20.0 - at;
                        sum += 0.5 * level * (soft(d + half, *width) - soft(d - half, *width));
                    }
                    bounded(sum)
                });
            }
            Self::Discs { bodies, width: edge, ground, share } => {
                let places: Vec<([f64; 2], &Body)> =
                    bodies.iter().map(|body| (body.at(t, width, height, 8.0), body)).collect();
                each(out, &|x, y| {
                    let mut value = share * bounded(ground.at(x, y));
                    for ([px, py], body) in &places {
                        let distance = libm::sqrt((x - px) * (x - px) + (y - py) * (y - py));
                        let inside = 0.5 + 0.5 * soft(body.radius - distance, *edge);
                        value += inside * (body.level - value);
                    }
                    value
                });
            }
            Self::Rings { centre, wavelength, speed, texture } => each(out, &|x, y| {
                let (dx, dy) = (x - centre[0], y - centre[1]);
                // Rounded at the centre, where a cone's tip would move no more.
                let r = libm::sqrt(dx * dx + dy * dy + 4.0);
                libm::sin(2.0 * PI * (r - speed * t) / wavelength) * (0.6 + 0.4 * bounded(texture.at(x, y)))
            }),
            Self::Shake { texture, reach, frequency, phase } => {
                let [dx, dy] = [0, 1].map(|k| reach[k] * libm::sin(2.0 * PI * frequency[k] * t + phase[k]));
                each(out, &|x, y| bounded(texture.at(x - dx, y - dy)));
            }
            Self::Shear { texture, speed, spread, period } => each(out, &|x, y| {
                let v = speed + spread * libm::sin(2.0 * PI * y / period);
                bounded(texture.at(x - v * t, y))
            }),
            Self::Chess { cell, omega, velocity, width, ground } => {
                let turn = turned(-omega * t, &middle);
                each(out, &|x, y| {
                    let (u, v) = turn(x, y);
                    let line = |d: f64| soft(libm::sin(PI * d / cell) * cell / PI, *width);
                    0.9 * line(u - velocity[0] * t) * line(v - velocity[1] * t)
                        + 0.1 * bounded(ground.at(x, y))
                });
            }
            Self::Spots { spots, ground } => {
                let places: Vec<[f64; 4]> = spots
                    .iter()
                    .map(|[x, y, rx, ry, fx, fy, size, level]| {
                        [
                            x + rx * libm::sin(2.0 * PI * fx * t),
                            y + ry * libm::cos(2.0 * PI * fy * t),
                            size * size,
                            *level,
                        ]
                    })
                    .collect();
                each(out, &|x, y| {
                    let mut sum = 0.3 * bounded(ground.at(x, y));
                    for [px, py, size2, level] in &places {
                        let bump = 1.0 / (1.0 + ((x - px) * (x - px) + (y - py) * (y - py)) / size2);
                        sum += level * bump * bump;
                    }
                    bounded(sum)
                });
            }
            Self::Waves { waves } => each(out, &|x, y| {
                let sum: f64 = waves
                    .iter()
                    .map(|[kx, ky, omega, phase]| libm::sin(kx * x + ky * y - omega * t + phase))
                    .sum();
                bounded(0.6 * sum)
            }),
            Self::Star(star) => each(out, &|x, y| libm::log(star.reflectance(x, y, t))),
            Self::View(view) => view.pattern(t, t, grid, out),
            #[cfg(test)]
            Self::Ramp { slope } => out.fill(slope * t),
        }
    }
}

impl Scene {
    /// `ln i` over `grid` at time `t` (s), row by row.
    pub fn log_light(&self, t: f64, grid: &Grid, width: f64, height: f64, out: &mut [f64]) {
        match &self.family {
            Family::View(view) => view.pattern(t, self.pace * t, grid, out),
            family => family.pattern(self.pace * t, grid, width, height, out),
        }
        let lamp = self.flicker.map_or(0.0, |[depth, frequency, phase]| {
            libm::log1p(depth * libm::sin(2.0 * PI * frequency * t + phase))
        });
        for v in out {
            *v = self.mean + lamp + self.contrast * *v;
        }
    }
}
