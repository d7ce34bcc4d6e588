// Data sets of the examples in the documentation.

/// Five frames of a walk and of a kick of a triangle, in `raw` and in `packed`; the kick is the
/// test set.
#[allow(dead_code)]
fn triangles() -> Result<tempfile::TempDir, Box<dyn std::error::Error>> {
    use cape_core::Outfit;
    use cape_data::{PackOptions, SequenceList, SplitSpec, pack, raw};

    let directory = tempfile::tempdir()?;
    let [raw, packed] = ["raw", "packed"].map(|name| directory.path().join(name));
    raw::write_minimal(&raw, "anna", &ndarray::Array2::zeros((3, 3)))?;
    for (sequence, size) in [("walk", 0.01), ("kick", 0.02)] {
        for number in 0..5 {
            let vertices = ndarray::Array2::from_elem((3, 3), size * f64::from(number));
            let frame = raw::RawFrame {
                v_cano: vertices.clone(),
                v_posed: vertices,
                pose: [0.0; 72],
                transl: [0.0; 3],
            };
            raw::write_frame(&raw, "anna", Outfit::LONG_LONG, sequence, number as usize, &frame)?;
        }
    }
    let list = |name: &str| SequenceList { sequences: vec![name.into()], exclude: Vec::new() };
    let split = SplitSpec {
        subjects: vec!["anna".into()],
        outfits: vec![Outfit::LONG_LONG],
        cut: 0,
        train: list("walk"),
        test: list("kick"),
        ..SplitSpec::default()
    };
    pack(&raw, &packed, &split, PackOptions::default(), &mut cape_core::silent)?;
    Ok(directory)
}

/// Four frames of a squat and of a kick of a synthetic subject, in `raw` and in `packed`; the kick
/// is the test set.
#[allow(dead_code)]
fn captures() -> Result<tempfile::TempDir, Box<dyn std::error::Error>> {
    use cape_core::Outfit;
    use cape_synth::{Motion, CaptureGenerator, SynthSpec, synthetic_body};
    use cape_data::{PackOptions, SequenceList, SplitSpec, pack};

    let directory = tempfile::tempdir()?;
    let [raw, packed] = ["raw", "packed"].map(|name| directory.path().join(name));
    let spec = SynthSpec {
        subjects: 1,
        frames_per_sequence: 4,
        outfits: vec![Outfit::LONG_LONG],
        motions: vec![Motion::Squats, Motion::Soccer],
        ..SynthSpec::default()
    };
    let list =
        |motion: Motion| SequenceList { sequences: vec![motion.to_string()], exclude: Vec::new() };
    let split = SplitSpec {
        subjects: spec.subject_names(),
        outfits: spec.outfits.clone(),
        cut: 0,
        train: list(Motion::Squats),
        test: list(Motion::Soccer),
        ..SplitSpec::default()
    };
    CaptureGenerator::new(&synthetic_body(), spec)?.write(&raw, &mut cape_core::silent)?;
    pack(&raw, &packed, &split, PackOptions::default(), &mut cape_core::silent)?;
    Ok(directory)
}
