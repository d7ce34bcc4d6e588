//! Pages that send anything to `cape view`.

use std::{fs, process::Child};

use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use serde_json::Value;
use tungstenite::Message;

use crate::{serve::serve, support::trained};

/// Bytes that the server's memory may grow by while it answers.
const GROWTH: u64 = 24 << 20;

struct Viewer {
    child: Child,
    address: String,
}

impl Viewer {
    fn start() -> Self {
        let run = trained().at("run");
        let (child, report) = serve(["view", run.to_str().unwrap(), "--no-open"]);
        let url = report["url"].as_str().unwrap().trim_end_matches('/');
        let address = format!("{}/socket", url.replace("http://", "ws://"));
        Self { child, address }
    }

    /// Resident memory, bytes; `None` where the system does not tell.
    fn memory(&self) -> Option<u64> {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
        Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? << 10)
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Messages as the page sends them.
fn valid(rng: &mut ChaCha8Rng) -> String {
    let numbers = |rng: &mut ChaCha8Rng, count: usize| {
        let numbers: Vec<String> =
            (0..count).map(|_| format!("{:.3}", rng.random_range(-1.0..1.0))).collect();
        numbers.join(",")
    };
    let id = rng.random_range(1..1000);
    let latent = trained_latent();
    match rng.random_range(0..6) {
        0 | 1 => format!(
            r#"{{"id":{id},"show":{{"z":[{}],"betas":[{}],"pose":[{}],"outfit":"longlong","layers":["clothed","body"]}}}}"#,
            numbers(rng, latent),
            numbers(rng, 2),
            numbers(rng, 72)
        ),
        2 => format!(
            r#"{{"id":{id},"sample":{{"prior":"gmm","temperature":1,"seed":{id},"outfit":"shortlong"}}}}"#
        ),
        3 => format!(
            r#"{{"id":{id},"carry":{{"z":[{}],"from":"longlong","to":"shortlong"}}}}"#,
            numbers(rng, latent)
        ),
        4 => format!(r#"{{"id":{id},"encode":{}}}"#, rng.random_range(0..20)),
        _ => format!(r#"{{"id":{id},"motion":{{"name":"walk","seconds":1.5,"fps":10}}}}"#),
    }
}

/// Number of latent variables of the trained run.
fn trained_latent() -> usize {
    cape::infer::RunConfig::load(&trained().at("run/config.toml")).unwrap().model.latent
}

/// One of the changes that make a message wrong.
fn change(text: &mut String, rng: &mut ChaCha8Rng) {
    const NUMBERS: [&str; 8] =
        ["1e39", "-1", "18446744073709551616", "null", "[]", "{}", "\"\"", "1e-400"];
    let mut characters: Vec<char> = text.chars().collect();
    let at = rng.random_range(0..characters.len().max(1));
    match rng.random_range(0..5) {
        0 => characters.truncate(at),
        1 => {
            let digit = characters.iter().skip(at).position(char::is_ascii_digit);
            if let Some(digit) = digit {
                let new = NUMBERS[rng.random_range(0..NUMBERS.len())];
                characters.splice(at + digit..=at + digit, new.chars());
            }
        }
        2 => characters.insert(
            at.min(characters.len()),
            ['"', '{', ',', ']', '\u{0}', 'é'][rng.random_range(0..6)],
        ),
        3 => drop(characters.drain(at..(at + 7).min(characters.len()))),
        _ => {
            let piece: Vec<char> = characters.iter().skip(at).take(20).copied().collect();
            characters.splice(at..at, piece);
        }
    }
    *text = characters.into_iter().collect();
}

#[test]
fn every_message_is_answered_and_memory_does_not_grow() {
    let messages: usize =
        std::env::var("CAPE_FUZZ_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(600);
    let mut viewer = Viewer::start();
    let mut socket = tungstenite::connect(&viewer.address).unwrap().0;
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut pictures, mut refused, mut before) = (0, 0, None);
    for number in 0..messages {
        let mut text = valid(&mut rng);
        for _ in 0..rng.random_range(0..=2) {
            change(&mut text, &mut rng);
        }
        socket.send(Message::text(text.clone())).unwrap();
        match socket.read().unwrap_or_else(|error| panic!("{error} after {text}")) {
            Message::Binary(bytes) => {
                assert_eq!(&bytes[..4], b"CAPE");
                pictures += 1;
            }
            Message::Text(answer) => {
                let answer: Value = serde_json::from_str(&answer).unwrap();
                refused += usize::from(answer["error"].is_string());
            }
            other => panic!("{other:?} after {text}"),
        }
        assert!(viewer.child.try_wait().unwrap().is_none(), "ended after {text}");
        // After the first answers everything that is kept has been made.
        if number == messages / 4 {
            before = viewer.memory();
        }
    }
    println!("{messages} messages: {pictures} pictures, {refused} refused");
    assert!(pictures > messages / 20 && refused > messages / 20);
    if let (Some(before), Some(after)) = (before, viewer.memory()) {
        println!("memory {} to {} MiB", before >> 20, after >> 20);
        assert!(after < before + GROWTH, "{before} bytes to {after}");
    }
}
