//! A small net that proposes causes: deviations in spreads of the floor and the context go in, a probability of every effect and of none comes out.
//!
//! Two hidden layers; trained on templates plus deviations of nulls, with dropout. It never sees a recording whose effect is known from elsewhere.
//! Everything is f32 in a fixed order, so the same seed gives the same weights with any number of threads.

use crate::candidates::CANDIDATES;
use crate::floor::Floor;
use crate::train::Example;
use photocurrent_core::random::Random;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// A fully connected layer: `out = in * weights + bias`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Layer {
    /// Length of the input.
    pub inputs: usize,
    /// Length of the output.
    pub outputs: usize,
    /// [inputs][outputs].
    pub weights: Vec<f32>,
    /// [outputs].
    pub bias: Vec<f32>,
}

/// The net.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Net {
    /// What an output stands for: catalogue ids, then `consistent`.
    pub labels: Vec<String>,
    /// Mean and spread of the context's numbers.
    pub context: Vec<(f32, f32)>,
    /// Layers; between them what is negative becomes 0.
    pub layers: Vec<Layer>,
}

/// How the net is trained.
#[derive(Clone, Copy, Debug)]
pub struct NetSetting {
    /// Seed.
    pub seed: u64,
    /// Width of the hidden layers.
    pub width: usize,
    /// Steps of the optimiser.
    pub steps: usize,
    /// Examples of a step.
    pub batch: usize,
    /// Share of hidden values that are dropped.
    pub dropout: f32,
    /// Largest step of a weight.
    pub rate: f32,
}

impl Default for NetSetting {
    fn default() -> NetSetting {
        NetSetting { seed: 1, width: 192, steps: 3000, batch: 64, dropout: 0.3, rate: 1e-3 }
    }
}

/// Catalogue ids of the candidates in order, each once, then `consistent`.
pub fn labels() -> Vec<String> {
    let mut labels: Vec<String> = Vec::new();
    for candidate in CANDIDATES {
        if labels.iter().all(|label| label != candidate.id) {
            labels.push(candidate.id.to_owned());
        }
    }
    labels.push("consistent".to_owned());
    labels
}

fn axpy(into: &mut [f32], a: f32, x: &[f32]) {
    for (into, x) in into.iter_mut().zip(x) {
        *into += a * x;
    }
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; 8];
    for (a, b) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        for n in 0..8 {
            lanes[n] += a[n] * b[n];
        }
    }
    let whole = a.len() / 8 * 8;
    lanes.iter().sum::<f32>() + a[whole..].iter().zip(&b[whole..]).map(|(a, b)| a * b).sum::<f32>()
}

impl Layer {
    fn random(inputs: usize, outputs: usize, random: &mut Random) -> Layer {
        let sigma = libm::sqrt(2.0 / inputs as f64);
        Layer { inputs, outputs, weights: (0..inputs * outputs).map(|_| (sigma * random.normal()) as f32).collect(), bias: vec![0.0; outputs] }
    }

    fn run(&self, x: &[f32]) -> Vec<f32> {
        let mut out = self.bias.clone();
        for (x, row) in x.iter().zip(self.weights.chunks_exact(self.outputs)) {
            if *x != 0.0 {
                axpy(&mut out, *x, row);
            }
        }
        out
    }
}

fn softmax(logits: &[f32]) -> Vec<f32> {
    let most = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let powers: Vec<f32> = logits.iter().map(|x| libm::expf(x - most)).collect();
    let sum: f32 = powers.iter().sum();
    powers.iter().map(|p| p / sum).collect()
}

impl Net {
    /// What goes into the first layer for a deviation in spreads and a context.
    pub fn input(&self, z: &[f64], context: &[f64]) -> Vec<f32> {
        let mut input: Vec<f32> = z.iter().map(|z| squeezed(*z)).collect();
        input.extend(context.iter().zip(&self.context).map(|(c, (mean, spread))| ((*c as f32 - mean) / spread).clamp(-3.0, 3.0)));
        input
    }

    /// Probability of every label.
    pub fn run(&self, input: &[f32]) -> Vec<f32> {
        let mut x = input.to_vec();
        for (n, layer) in self.layers.iter().enumerate() {
            x = layer.run(&x);
            if n + 1 < self.layers.len() {
                x.iter_mut().for_each(|x| *x = x.max(0.0));
            }
        }
        softmax(&x)
    }

    /// Trains a net on templates, with deviations of the floor's nulls (but those that `is_kept` refuses) added to them.
    pub fn train(examples: &[Example], floor: &Floor, setting: &NetSetting) -> Net {
        let labels = labels();
        let nulls = Nulls::of(floor);
        let usable: Vec<&Example> = examples.iter().filter(|example| example.candidate.is_some()).collect();
        let inputs = floor.nulls.first().map_or(0, |null| null.deviation.len() + null.context.len());
        let mut random = Random::new(setting.seed, &[1]);
        let sizes = [inputs, setting.width, setting.width, labels.len()];
        let layers = sizes.windows(2).map(|pair| Layer::random(pair[0], pair[1], &mut random)).collect();
        let mut net = Net { context: context_scale(floor), labels, layers };
        if usable.is_empty() || floor.nulls.is_empty() {
            return net;
        }
        // Examples by label, so that labels with several candidates are not more frequent.
        let of = |label: &str| -> Vec<&Example> { usable.iter().copied().filter(|e| e.candidate.is_some_and(|n| CANDIDATES[n].id == label)).collect() };
        let by_label: Vec<Vec<&Example>> = net.labels.iter().map(|label| of(label)).collect();
        let mut optimiser = Adam::new(&net);
        for step in 0..setting.steps {
            let gradient = net.gradient(&by_label, &nulls, setting, step as u64);
            let done = step as f32 / setting.steps as f32;
            let rate = setting.rate * f32::min(1.0, step as f32 / 50.0) * 0.5 * (1.0 + libm::cosf(std::f32::consts::PI * done)).max(0.02);
            optimiser.step(&mut net, &gradient, rate);
        }
        net
    }

    fn gradient(&self, by_label: &[Vec<&Example>], nulls: &Nulls, setting: &NetSetting, step: u64) -> Vec<Layer> {
        const PARTS: usize = 8;
        let parts: Vec<Vec<Layer>> = (0..PARTS)
            .into_par_iter()
            .map(|part| {
                let mut gradient = self.zero();
                for n in (part..setting.batch).step_by(PARTS) {
                    let mut random = Random::new(setting.seed, &[2, step, n as u64]);
                    let (input, target) = nulls.draw(self, by_label, &mut random);
                    self.backward(&input, &target, setting.dropout, &mut random, &mut gradient);
                }
                gradient
            })
            .collect();
        let mut sum = self.zero();
        for part in &parts {
            for (sum, layer) in sum.iter_mut().zip(part) {
                axpy(&mut sum.weights, 1.0 / setting.batch as f32, &layer.weights);
                axpy(&mut sum.bias, 1.0 / setting.batch as f32, &layer.bias);
            }
        }
        sum
    }

    fn zero(&self) -> Vec<Layer> {
        self.layers.iter().map(|layer| Layer { weights: vec![0.0; layer.weights.len()], bias: vec![0.0; layer.bias.len()], ..*layer }).collect()
    }

    fn backward(&self, input: &[f32], target: &[f32], dropout: f32, random: &mut Random, gradient: &mut [Layer]) {
        let mut inputs: Vec<Vec<f32>> = vec![input.to_vec()];
        for (n, layer) in self.layers.iter().enumerate() {
            let mut out = layer.run(&inputs[n]);
            if n + 1 < self.layers.len() {
                for x in &mut out {
                    let keep = random.uniform() as f32 >= dropout;
                    *x = if keep { x.max(0.0) / (1.0 - dropout) } else { 0.0 };
                }
            }
            inputs.push(out);
        }
        let last = self.layers.len();
        let mut delta: Vec<f32> = softmax(&inputs[last]).iter().zip(target).map(|(p, t)| p - t).collect();
        for n in (0..last).rev() {
            let (layer, into) = (&self.layers[n], &mut gradient[n]);
            axpy(&mut into.bias, 1.0, &delta);
            let mut below = vec![0.0; layer.inputs];
            for (k, x) in inputs[n].iter().enumerate() {
                if *x != 0.0 {
                    let row = k * layer.outputs..(k + 1) * layer.outputs;
                    axpy(&mut into.weights[row.clone()], *x, &delta);
                    // A value that is 0 was cut or dropped: nothing flows back through it.
                    below[k] = if n > 0 { dot(&layer.weights[row], &delta) / (1.0 - dropout) } else { 0.0 };
                }
            }
            delta = below;
        }
    }
}

fn squeezed(z: f64) -> f32 {
    libm::asinh(z / 1.5) as f32
}

fn context_scale(floor: &Floor) -> Vec<(f32, f32)> {
    let length = floor.nulls.first().map_or(0, |null| null.context.len());
    let n = floor.nulls.len().max(1) as f32;
    (0..length)
        .map(|k| {
            let mean = floor.nulls.iter().map(|null| null.context[k]).sum::<f32>() / n;
            let square = floor.nulls.iter().map(|null| (null.context[k] - mean) * (null.context[k] - mean)).sum::<f32>() / n;
            (mean, square.sqrt() + 1e-3)
        })
        .collect()
}

/// Nulls with their own floors, from which examples are drawn.
struct Nulls {
    contexts: Vec<Vec<f64>>,
    z: Vec<Vec<f64>>,
    spread: Vec<Vec<f64>>,
    scale: Vec<(f32, f32)>,
}

/// Shares of drawn examples: without an effect, and with two.
const CONSISTENT: f64 = 0.2;
const TWO: f64 = 0.15;

impl Nulls {
    fn of(floor: &Floor) -> Nulls {
        let wide = |values: &[f32]| -> Vec<f64> { values.iter().map(|v| f64::from(*v)).collect() };
        let contexts: Vec<Vec<f64>> = floor.nulls.iter().map(|null| wide(&null.context)).collect();
        let levels: Vec<_> = (0..contexts.len()).into_par_iter().map(|n| floor.level(&contexts[n])).collect();
        let z = floor.nulls.iter().zip(&levels).map(|(null, level)| level.z(&wide(&null.deviation))).collect();
        Nulls { contexts, z, spread: levels.into_iter().map(|level| level.spread).collect(), scale: context_scale(floor) }
    }

    /// A null of a context like an example's: the nearest of four at random.
    fn near(&self, context: &[f32], random: &mut Random) -> usize {
        let far = |n: usize| -> f64 {
            let apart = |((a, b), (_, s)): ((&f64, &f32), &(f32, f32))| (a - f64::from(*b)) / f64::from(*s);
            self.contexts[n].iter().zip(context).zip(&self.scale).map(apart).map(|apart| apart * apart).sum()
        };
        let mut best = (f64::INFINITY, 0);
        for _ in 0..4 {
            let n = (random.bits() % self.contexts.len() as u64) as usize;
            let distance = far(n);
            if distance < best.0 {
                best = (distance, n);
            }
        }
        best.1
    }

    /// An input and its target.
    fn draw(&self, net: &Net, by_label: &[Vec<&Example>], random: &mut Random) -> (Vec<f32>, Vec<f32>) {
        let kind = random.uniform();
        let filled: Vec<usize> = (0..by_label.len()).filter(|n| !by_label[*n].is_empty()).collect();
        let count = if kind < CONSISTENT { 0 } else { 1 + usize::from(kind > 1.0 - TWO) };
        let mut target = vec![0.0; net.labels.len()];
        let mut chosen: Vec<(&Example, f64)> = Vec::new();
        for _ in 0..count {
            let label = filled[(random.bits() % filled.len() as u64) as usize];
            let example = by_label[label][(random.bits() % by_label[label].len() as u64) as usize];
            chosen.push((example, libm::exp2(1.2 * random.uniform() - 0.7)));
            target[label] += 1.0 / count as f32;
        }
        let null = match chosen.first() {
            Some((example, _)) => self.near(&example.context, random),
            None => (random.bits() % self.contexts.len() as u64) as usize,
        };
        if chosen.is_empty() {
            target[net.labels.len() - 1] = 1.0;
        }
        // Between two nulls: few are there, and the net must not know them by heart.
        let other = self.near(&self.contexts[null].iter().map(|c| *c as f32).collect::<Vec<f32>>(), random);
        let share = 0.4 * random.uniform();
        let size = 0.8 + 0.5 * random.uniform();
        let mut z: Vec<f64> = self.z[null].iter().zip(&self.z[other]).map(|(a, b)| size * ((1.0 - share) * a + share * b)).collect();
        for (example, strength) in chosen {
            for ((z, t), s) in z.iter_mut().zip(&example.deviation).zip(&self.spread[null]) {
                *z += strength * f64::from(*t) / s;
            }
        }
        let mut input = net.input(&z, &self.contexts[null]);
        let summaries = z.len();
        for (n, x) in input.iter_mut().enumerate() {
            if n < summaries && random.uniform() < 0.1 {
                *x = 0.0;
            }
        }
        (input, target)
    }
}

/// The optimiser of Kingma and Ba (2015) with decay of weights.
struct Adam {
    mean: Vec<Layer>,
    square: Vec<Layer>,
    step: i32,
}

impl Adam {
    fn new(net: &Net) -> Adam {
        Adam { mean: net.zero(), square: net.zero(), step: 0 }
    }

    fn step(&mut self, net: &mut Net, gradient: &[Layer], rate: f32) {
        self.step += 1;
        let left = |rate: f64| libm::pow(rate, f64::from(self.step)) as f32;
        let (fix_mean, fix_square) = (1.0 - left(0.9), 1.0 - left(0.999));
        let update = |w: &mut [f32], m: &mut [f32], v: &mut [f32], g: &[f32], decay: f32| {
            for n in 0..w.len() {
                m[n] = 0.9 * m[n] + 0.1 * g[n];
                v[n] = 0.999 * v[n] + 0.001 * g[n] * g[n];
                w[n] -= rate * (m[n] / fix_mean / ((v[n] / fix_square).sqrt() + 1e-7) + decay * w[n]);
            }
        };
        for (((layer, mean), square), gradient) in net.layers.iter_mut().zip(&mut self.mean).zip(&mut self.square).zip(gradient) {
            update(&mut layer.weights, &mut mean.weights, &mut square.weights, &gradient.weights, 1e-2);
            update(&mut layer.bias, &mut mean.bias, &mut square.bias, &gradient.bias, 0.0);
        }
    }
}
