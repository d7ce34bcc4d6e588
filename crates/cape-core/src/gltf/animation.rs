//! Animation of the nodes of a `.glb` file.

use glam::{Mat4, Quat, Vec3};
use serde_json::Value;

use super::accessor::{Data, Rows};

/// Transform and morph weights of a node at one time.
#[derive(Debug, Clone)]
pub(super) struct NodeState {
    translation: Vec3,
    rotation: Quat,
    scale: Vec3,
    /// In place of the other three, which cannot be animated then.
    matrix: Option<Mat4>,
    pub(super) weights: Vec<f32>,
}

/// First animation of a file.
#[derive(Debug)]
pub(super) struct Animation {
    channels: Vec<Channel>,
}

#[derive(Debug)]
struct Channel {
    node: usize,
    path: Path,
    interpolation: Interpolation,
    times: Vec<f32>,
    /// Numbers of one key.
    width: usize,
    values: Vec<f32>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Path {
    Translation,
    Rotation,
    Scale,
    Weights,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Interpolation {
    Linear,
    Step,
    /// In-tangent, value and out-tangent for each key.
    CubicSpline,
}

impl NodeState {
    /// State that the file stores.
    pub(super) fn stored(node: &Value, mesh: &Value) -> Self {
        let numbers = |list: &Value| -> Option<Vec<f32>> {
            list.as_array()?.iter().map(|x| x.as_f64().map(|x| x as f32)).collect()
        };
        let vector = |name: &str, other: Vec3| {
            let found = numbers(&node[name]).and_then(|list| <[f32; 3]>::try_from(list).ok());
            found.map_or(other, Vec3::from)
        };
        let rotation = numbers(&node["rotation"]).and_then(|list| <[f32; 4]>::try_from(list).ok());
        let matrix = numbers(&node["matrix"]).and_then(|list| <[f32; 16]>::try_from(list).ok());
        Self {
            translation: vector("translation", Vec3::ZERO),
            rotation: rotation.map_or(Quat::IDENTITY, Quat::from_array),
            scale: vector("scale", Vec3::ONE),
            matrix: matrix.map(|matrix| Mat4::from_cols_array(&matrix)),
            weights: numbers(&node["weights"]).or(numbers(&mesh["weights"])).unwrap_or_default(),
        }
    }

    /// Transform to the parent.
    pub(super) fn matrix(&self) -> Mat4 {
        let &Self { translation, rotation, scale, .. } = self;
        self.matrix
            .unwrap_or_else(|| Mat4::from_scale_rotation_translation(scale, rotation, translation))
    }
}

impl Animation {
    pub(super) fn first(data: &Data) -> Result<Option<Self>, String> {
        let animation = &data.document["animations"][0];
        let Some(list) = animation["channels"].as_array() else { return Ok(None) };
        let mut channels = Vec::new();
        for channel in list {
            let path = match channel["target"]["path"].as_str() {
                Some("translation") => Path::Translation,
                Some("rotation") => Path::Rotation,
                Some("scale") => Path::Scale,
                Some("weights") => Path::Weights,
                _ => continue,
            };
            let Some(node) = channel["target"]["node"].as_u64() else { continue };
            let number = channel["sampler"].as_u64().ok_or("a channel without a sampler")?;
            let sampler = &animation["samplers"][number as usize];
            let accessor = |name: &str| {
                sampler[name].as_u64().ok_or_else(|| format!("sampler {number} has no {name}"))
            };
            let times: Vec<f32> = data.rows(accessor("input")?)?.numbers;
            let values = data.rows(accessor("output")?)?;
            let interpolation = match sampler["interpolation"].as_str() {
                Some("STEP") => Interpolation::Step,
                Some("CUBICSPLINE") => Interpolation::CubicSpline,
                _ => Interpolation::Linear,
            };
            channels.push(Channel::new(node as usize, path, interpolation, times, values)?);
        }
        Ok((!channels.is_empty()).then_some(Self { channels }))
    }

    pub(super) fn time_range(&self) -> Option<([f64; 2], f64)> {
        let ends = |channel: &Channel| {
            [channel.times[0], channel.times[channel.times.len() - 1]].map(f64::from)
        };
        let [first, last] =
            self.channels.iter().map(ends).reduce(|[a, b], [c, d]| [a.min(c), b.max(d)])?;
        let rate = self.channels.iter().map(|channel| {
            let [first, last] = ends(channel);
            (channel.times.len() - 1) as f64 / (last - first)
        });
        let rate = rate.filter(|rate| rate.is_finite() && *rate > 0.0).fold(0.0, f64::max);
        Some(([first, last], rate))
    }

    pub(super) fn apply(&self, time: f64, states: &mut [NodeState]) {
        for channel in &self.channels {
            let Some(state) = states.get_mut(channel.node) else { continue };
            let value = channel.at(time as f32);
            match (channel.path, value.as_slice()) {
                (Path::Translation, &[x, y, z]) => state.translation = Vec3::new(x, y, z),
                (Path::Scale, &[x, y, z]) => state.scale = Vec3::new(x, y, z),
                (Path::Rotation, &[x, y, z, w]) => {
                    state.rotation = Quat::from_xyzw(x, y, z, w).normalize();
                }
                (Path::Weights, weights) => weights.clone_into(&mut state.weights),
                _ => {}
            }
        }
    }
}

impl Channel {
    fn new(
        node: usize,
        path: Path,
        interpolation: Interpolation,
        times: Vec<f32>,
        values: Rows,
    ) -> Result<Self, String> {
        let sorted = times.is_sorted_by(|a, b| a < b) && times.iter().all(|time| time.is_finite());
        if times.is_empty() || !sorted {
            return Err("the times of an animation do not increase".into());
        }
        let keys = times.len() * if interpolation == Interpolation::CubicSpline { 3 } else { 1 };
        let components = match path {
            Path::Translation | Path::Scale => 3,
            Path::Rotation => 4,
            Path::Weights => values.numbers.len() / keys,
        };
        if components == 0 || values.numbers.len() != keys * components {
            return Err(format!(
                "{} values of an animation of {} times",
                values.len(),
                times.len()
            ));
        }
        Ok(Self { node, path, interpolation, times, width: components, values: values.numbers })
    }

    fn key(&self, number: usize) -> &[f32] {
        &self.values[number * self.width..(number + 1) * self.width]
    }

    fn at(&self, time: f32) -> Vec<f32> {
        let cubic = self.interpolation == Interpolation::CubicSpline;
        let value = |key: usize| self.key(if cubic { 3 * key + 1 } else { key });
        let after = self.times.partition_point(|&key| key <= time);
        let Some(from) = after.checked_sub(1) else { return value(0).to_vec() };
        if after == self.times.len() || self.interpolation == Interpolation::Step {
            return value(from).to_vec();
        }
        let span = self.times[after] - self.times[from];
        let t = (time - self.times[from]) / span;
        let (a, b) = (value(from), value(after));
        if cubic {
            let (leaving, arriving) = (self.key(3 * from + 2), self.key(3 * after));
            let (t2, t3) = (t * t, t * t * t);
            let blend = |i: usize| {
                (2.0 * t3 - 3.0 * t2 + 1.0) * a[i]
                    + span * (t3 - 2.0 * t2 + t) * leaving[i]
                    + (3.0 * t2 - 2.0 * t3) * b[i]
                    + span * (t3 - t2) * arriving[i]
            };
            return (0..self.width).map(blend).collect();
        }
        if let (Path::Rotation, &[x, y, z, w], &[p, q, r, s]) = (self.path, a, b) {
            let (from, to) = (Quat::from_xyzw(x, y, z, w), Quat::from_xyzw(p, q, r, s));
            return from.normalize().slerp(to.normalize(), t).to_array().to_vec();
        }
        a.iter().zip(b).map(|(a, b)| a + t * (b - a)).collect()
    }
}
