//! Answers of raters, as the server and the exported pages write them.

use std::{collections::HashSet, fs, path::Path};

use cape_core::{Error, Result};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{StudyDesign, Trial};

/// Largest size of a file of answers, bytes.
const MOST_BYTES: u64 = 1 << 30;

/// Answer of a rater to a trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Name of the rater.
    pub rater: String,
    /// The pair and its sides.
    #[serde(flatten)]
    pub trial: Trial,
    /// Picture that was taken for real.
    pub chosen: String,
    /// Time from the appearance of both pictures to the answer, milliseconds.
    pub rt_ms: f64,
}

impl Answer {
    /// True if the generated picture was taken for real.
    pub fn is_fooled(&self, design: &StudyDesign) -> bool {
        design.pairs[self.trial.pair].generated.file == self.chosen
    }

    fn fault(&self, design: &StudyDesign) -> Option<String> {
        let Trial { pair, left, right } = &self.trial;
        let Some(known) = design.pairs.get(*pair) else {
            return Some(format!("pair {pair}, but the study has {}", design.pairs.len()));
        };
        let mut shown = [left.as_str(), right.as_str()];
        shown.sort_unstable();
        if shown != known.files() {
            return Some(format!("the pictures are not those of pair {pair}"));
        }
        if !shown.contains(&self.chosen.as_str()) {
            return Some(format!("`chosen` is no picture of pair {pair}"));
        }
        if !self.rt_ms.is_finite() || self.rt_ms < 0.0 {
            return Some(format!("`rt_ms` {}, expected at least 0", self.rt_ms));
        }
        None
    }
}

/// Reads answers: JSON objects and arrays of them, one after the other, as in `answers.jsonl` and in the
/// results of jsPsych, JATOS and DataPipe. Objects without `chosen` are other events. Of several answers
/// of a rater to a pair the first counts; a last line that was cut off is left out.
///
/// # Errors
/// If the file is no JSON, or an answer is not one to a pair of the study.
pub fn read_answers(design: &StudyDesign, path: impl AsRef<Path>) -> Result<Vec<Answer>> {
    let path = path.as_ref();
    let size = fs::metadata(path).map_err(|source| Error::io(path, source))?.len();
    if size > MOST_BYTES {
        return Err(Error::format(path, format!("{size} bytes, expected at most {MOST_BYTES}")));
    }
    let text = fs::read(path).map_err(|source| Error::io(path, source))?;
    let (mut answers, mut known) = (Vec::new(), HashSet::new());
    for value in serde_json::Deserializer::from_slice(&text).into_iter::<Value>() {
        let value = match value {
            Ok(value) => value,
            Err(error) if error.is_eof() => break,
            Err(error) => return Err(Error::format(path, error.to_string())),
        };
        let events = match value {
            Value::Array(events) => events,
            event => vec![event],
        };
        for event in events.into_iter().filter(|event| event.get("chosen").is_some()) {
            let answer: Answer = serde_json::from_value(event)
                .map_err(|error| Error::format(path, format!("answer: {error}")))?;
            if let Some(message) = answer.fault(design) {
                return Err(Error::format(path, format!("rater {}: {message}", answer.rater)));
            }
            if known.insert((answer.rater.clone(), answer.trial.pair)) {
                answers.push(answer);
            }
        }
    }
    Ok(answers)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::tests::design;

    #[test]
    fn all_writers_are_read_and_answers_counted_once() {
        let design = design(3, 1, 0, 3);
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("answers.jsonl");
        let answer = |rater: &str, place: usize| {
            let trial = design.schedule(0)[place].clone();
            Answer { rater: rater.into(), chosen: trial.left.clone(), trial, rt_ms: 800.0 }
        };
        let line = |answer: &Answer| serde_json::to_string(answer).unwrap();
        let (a, b, c) = (answer("a", 0), answer("a", 1), answer("b", 0));
        let again = Answer { chosen: a.trial.right.clone(), ..a.clone() };
        let text = format!(
            "{}\n{{\"event\":\"consent\"}}\n{}\n[{},{{\"trial_type\":\"x\"}}]{}\n{{\"rater\":\"b\",",
            line(&a),
            line(&again),
            line(&b),
            line(&c)
        );
        fs::write(&path, text).unwrap();
        assert_eq!(read_answers(&design, &path).unwrap(), [a.clone(), b, c]);
        for (what, wrong) in [
            ("pair 99", Answer { trial: Trial { pair: 99, ..a.trial.clone() }, ..a.clone() }),
            ("chosen", Answer { chosen: "x.png".into(), ..a.clone() }),
            (
                "not those",
                Answer { trial: Trial { left: "x".into(), ..a.trial.clone() }, ..a.clone() },
            ),
            ("rt_ms", Answer { rt_ms: -1.0, ..a.clone() }),
        ] {
            fs::write(&path, line(&wrong)).unwrap();
            let error = read_answers(&design, &path).unwrap_err().to_string();
            assert!(error.contains(what) && error.contains("answers.jsonl"), "{error}");
        }
    }
}
