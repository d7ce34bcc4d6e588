//! Messages between page and server.

use cape_core::{BodyPose, Mesh, Outfit};
use cape_infer::BodySpec;
use serde::{Deserialize, Serialize};

use crate::{
    error::{Error, Result},
    priors::PriorName,
};

/// "CAPE", little-endian.
const MAGIC: u32 = 0x4550_4143;
/// Longest motion, seconds, and highest frame rate.
const MOST_SECONDS: f64 = 60.0;
const MOST_RATE: f64 = 120.0;

/// Kind of a drawn body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum ViewLayer {
    Clothed,
    Body,
    Truth,
}

/// Request for a picture of a run.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShowRequest {
    pub(super) z: Vec<f32>,
    pub(super) betas: Vec<f32>,
    pose: Vec<f32>,
    outfit: Outfit,
    pub(super) layers: Vec<ViewLayer>,
    #[serde(default)]
    pub(super) truth: usize,
}

/// Request for a sampled code.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SampleRequest {
    prior: String,
    pub(super) temperature: f64,
    pub(super) seed: u64,
    pub(super) outfit: Outfit,
}

/// Request for the code of clothing in another outfit.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CarryRequest {
    pub(super) z: Vec<f32>,
    pub(super) from: Outfit,
    pub(super) to: Outfit,
}

/// Request for the poses of a motion.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MotionRequest {
    pub(super) name: String,
    pub(super) seconds: f64,
    pub(super) fps: f64,
}

/// Request for a picture of a clothing layer.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LayerRequest {
    pub(super) betas: Vec<f64>,
    /// Values of the parameters with sliders.
    pub(super) parameters: Vec<f64>,
    /// Name of the motion.
    pub(super) motion: String,
    pub(super) frame: usize,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Question {
    /// Picture of a run.
    Show(ShowRequest),
    /// Picture of a mesh or of a frame of a sequence.
    Frame(usize),
    /// Picture of a clothing layer.
    Worn(LayerRequest),
    /// Sampled code.
    Sample(SampleRequest),
    /// Code of clothing in another outfit.
    Carry(CarryRequest),
    /// Code, body and pose of a registration.
    Encode(usize),
    /// Poses of a motion.
    Motion(MotionRequest),
}

/// Message of the page.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct Request {
    pub(super) id: u32,
    #[serde(flatten)]
    pub(super) question: Question,
}

/// Request for a file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct Download {
    pub(super) format: FileFormat,
    #[serde(flatten)]
    pub(super) question: Question,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum FileFormat {
    Obj,
    Ply,
    Glb,
}

/// A drawn body.
#[derive(Debug, Clone)]
pub(super) struct Person {
    pub(super) layer: ViewLayer,
    pub(super) mesh: Mesh,
    pub(super) colours: Vec<[f32; 3]>,
    /// Lengths of displacements, metres, `[vertices]`.
    pub(super) distances: Vec<f32>,
    /// Distances from the registration, metres, `[vertices]`.
    pub(super) errors: Vec<f32>,
}

/// Answer to a request.
#[derive(Debug, Clone)]
pub(super) enum Answer {
    People(Vec<Person>),
    Code { z: Vec<f32> },
    Registration { z: Vec<f32>, wearer: Box<BodySpec> },
    Poses { poses: Vec<BodyPose>, fps: f64 },
}

impl Question {
    /// True if a newer request replaces it.
    pub(super) const fn is_superseded(&self) -> bool {
        matches!(self, Self::Show(_) | Self::Frame(_) | Self::Worn(_))
    }
}

impl ShowRequest {
    pub(super) fn body_spec(&self) -> Result<BodySpec> {
        let pose = BodyPose::try_from(self.pose.as_slice()).map_err(|_| {
            Error::message(format!("pose has {} values, expected 72", self.pose.len()))
        })?;
        if pose.iter().chain(&self.z).chain(&self.betas).any(|x| !x.is_finite()) {
            return Err(Error::message("pose, betas and z must be finite"));
        }
        Ok(BodySpec { betas: self.betas.clone(), pose, outfit: self.outfit })
    }
}

impl SampleRequest {
    pub(super) fn prior(&self) -> Result<PriorName> {
        <PriorName as clap::ValueEnum>::from_str(&self.prior, false).map_err(|_| {
            Error::message(format!("unknown prior `{}`: expected normal, gmm or kde", self.prior))
        })
    }
}

impl MotionRequest {
    pub(super) fn check(&self) -> Result {
        let fits = |value: f64, most: f64| value > 0.0 && value <= most;
        if fits(self.seconds, MOST_SECONDS) && fits(self.fps, MOST_RATE) {
            return Ok(());
        }
        Err(Error::message(format!(
            "motion of {} s at {} frames per second: expected at most {MOST_SECONDS} s and {MOST_RATE} \
             frames per second",
            self.seconds, self.fps
        )))
    }
}

#[derive(Serialize)]
struct Text<'a> {
    id: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    z: Option<&'a [f32]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    betas: Option<&'a [f32]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pose: Option<&'a [f32]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    outfit: Option<Outfit>,
    #[serde(skip_serializing_if = "Option::is_none")]
    poses: Option<Vec<&'a [f32]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fps: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<&'a str>,
}

const NOTHING: Text<'static> = Text {
    id: 0,
    z: None,
    betas: None,
    pose: None,
    outfit: None,
    poses: None,
    fps: None,
    error: None,
};

/// Message to the page.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Message {
    Text(String),
    Binary(Vec<u8>),
}

/// Message with an answer or an error.
pub(super) fn encode(id: u32, answer: &Result<Answer>) -> Message {
    let text = match answer {
        Ok(Answer::People(people)) => return Message::Binary(encode_people(id, people)),
        Ok(Answer::Code { z }) => Text { id, z: Some(z), ..NOTHING },
        Ok(Answer::Registration { z, wearer }) => Text {
            id,
            z: Some(z),
            betas: Some(&wearer.betas),
            pose: Some(&wearer.pose),
            outfit: Some(wearer.outfit),
            ..NOTHING
        },
        Ok(Answer::Poses { poses, fps }) => {
            let poses = Some(poses.iter().map(|pose| &pose[..]).collect());
            Text { id, poses, fps: Some(*fps), ..NOTHING }
        }
        Err(error) => return failure(id, &error.to_string()),
    };
    Message::Text(serde_json::to_string(&text).unwrap_or_default())
}

/// Message with an error.
pub(super) fn failure(id: u32, error: &str) -> Message {
    let text = Text { id, error: Some(error), ..NOTHING };
    Message::Text(serde_json::to_string(&text).unwrap_or_default())
}

fn encode_people(id: u32, people: &[Person]) -> Vec<u8> {
    let vertices = people.first().map_or(0, |person| person.mesh.vertices.len());
    let mut bytes = Vec::with_capacity(16 + people.len() * (4 + vertices * 24));
    for number in [MAGIC, id, people.len() as u32, vertices as u32] {
        bytes.extend(number.to_le_bytes());
    }
    for person in people {
        bytes.extend((person.layer as u32).to_le_bytes());
        let positions = person.mesh.vertices.as_flattened();
        for value in positions.iter().chain(&person.distances).chain(&person.errors) {
            bytes.extend(value.to_le_bytes());
        }
        for &colour in &person.colours {
            let [r, g, b] = crate::dressed_mesh::eight_bit(colour);
            bytes.extend([r, g, b, 255]);
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn questions_are_read_and_nonsense_is_refused() {
        let read = |text: &str| serde_json::from_str::<Request>(text);
        let request = read(r#"{"id":3,"frame":2}"#).unwrap();
        assert_eq!(request, Request { id: 3, question: Question::Frame(2) });
        let text = r#"{"id":4,"show":{"z":[0.5],"betas":[],"pose":[0,0],"outfit":"longlong","layers":["clothed","truth"],"truth":7}}"#;
        let Question::Show(show) = read(text).unwrap().question else { panic!("not a show") };
        assert_eq!(
            (show.truth, &show.layers[..]),
            (7, &[ViewLayer::Clothed, ViewLayer::Truth][..])
        );
        let text =
            r#"{"id":5,"worn":{"betas":[1],"parameters":[0.8],"motion":"squats","frame":2}}"#;
        let worn = read(text).unwrap().question;
        assert!(worn.is_superseded() && matches!(worn, Question::Worn(_)));
        assert!(show.body_spec().unwrap_err().to_string().contains("pose has 2 values"));
        for nonsense in
            ["", "7", "{}", r#"{"id":1}"#, r#"{"id":-1,"frame":0}"#, r#"{"id":1,"shut":0}"#]
        {
            assert!(read(nonsense).is_err(), "{nonsense}");
        }
    }

    #[test]
    fn people_are_laid_out_as_the_page_reads_them() {
        let person = Person {
            layer: ViewLayer::Body,
            mesh: Mesh { vertices: vec![[1.0, 2.0, 3.0]], faces: Vec::new() },
            colours: vec![[1.0, 0.0, 0.5]],
            distances: vec![4.0],
            errors: vec![5.0],
        };
        let Message::Binary(bytes) = encode(9, &Ok(Answer::People(vec![person]))) else {
            panic!("not binary")
        };
        let word = |i: usize| [0, 1, 2, 3].map(|j| bytes[4 * i + j]);
        let whole = |i: usize| u32::from_le_bytes(word(i));
        assert_eq!([0, 1, 2, 3, 4].map(whole), [MAGIC, 9, 1, 1, 1]);
        assert_eq!(&bytes[..4], b"CAPE");
        let float = |i: usize| f32::from_le_bytes(word(i));
        assert_eq!([5, 6, 7, 8, 9].map(float), [1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(&bytes[40..], &[255, 0, 128, 255]);
    }
}
