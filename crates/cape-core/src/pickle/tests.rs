use std::path::PathBuf;

use ndarray::{ArrayD, array};
use proptest::prelude::*;

use super::*;
use crate::{
    SmplModel,
    npy::{Npz, read_objects},
};

fn fixtures() -> PathBuf {
    PathBuf::from("fixtures/pickles")
}

fn named(start: &str) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = fs::read_dir(fixtures())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.file_name().unwrap().to_str().unwrap().starts_with(start))
        .collect();
    paths.sort();
    paths
}

fn parse(source: &[u8]) -> Result<Pickle> {
    Pickle::parse("test.pkl", source.to_vec())
}

/// Calls every accessor on the values of a pickle.
fn exercise(pickle: &Pickle) {
    let root = pickle.root();
    let mut values = vec![root.clone()];
    values.extend(root.keys().iter().take(8).filter_map(|key| root.get(key)));
    values.extend(root.elements().into_iter().flatten().take(8));
    for value in values {
        let _ = (value.text(), value.int(), value.class(), value.keys(), value.is_sparse());
        let _ = (value.array::<f64>(), value.array::<u32>(), value.sparse(), value.objects());
        let _ = value.matrix([2, 2]);
    }
}

#[test]
fn all_encodings_of_a_body_are_equal() {
    let expected = SmplModel::load(fixtures().join("expected.npz")).unwrap();
    let paths = named("body_");
    assert!(paths.len() >= 11, "{paths:?}");
    for path in paths {
        let found = SmplModel::load(&path).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(found, expected, "{}", path.display());
    }
}

#[test]
fn errors_name_the_cause() {
    let message = |name: &str| {
        SmplModel::load(fixtures().join(format!("bad_{name}.pkl"))).unwrap_err().to_string()
    };
    for (name, expected) in [
        ("system", "`posix.system`"),
        ("eval", "`builtins.eval`"),
        ("fromfile", "fromfile`"),
        ("truncated", "unexpected end"),
        ("weights", "`weights`: shape [4, 3], expected [5, 3]"),
        ("missing", "`posedirs`: missing"),
        ("computed", "chumpy.ch_ops.add"),
        ("smplh", "SMPL-H"),
    ] {
        let message = message(name);
        assert!(message.contains(expected) && message.contains(name), "{message}");
    }
}

#[test]
fn object_arrays_hold_sparse_matrices() {
    let pickle = read_objects(fixtures().join("object_array.npy")).unwrap();
    let (shape, matrices) = pickle.root().objects().unwrap();
    assert_eq!(shape, [2]);
    let expected: ndarray::Array2<f64> = {
        let array = Npz::open(fixtures().join("expected.npz")).unwrap().f64("J_regressor").unwrap();
        array.into_dimensionality().unwrap()
    };
    assert_eq!(matrices[0].matrix([3, 5]).unwrap(), expected);
    assert_eq!(matrices[1].matrix([5, 3]).unwrap(), expected.t());
    assert_eq!(matrices[1].sparse().unwrap().shape, [5, 3]);
    let message = matrices[1].matrix([5, 5]).unwrap_err().to_string();
    assert!(message.contains("[5, 3], expected [5, 5]"), "{message}");
}

#[test]
fn mixtures_are_read() {
    let mut expected = Npz::open(fixtures().join("expected_mixture.npz")).unwrap();
    for (name, covariances) in [("GaussianMixture", "covariances_"), ("GMM", "covars_")] {
        let pickle = Pickle::open(fixtures().join(format!("mixture_{name}.pkl"))).unwrap();
        let root = pickle.root();
        assert!(root.class().unwrap().ends_with(name));
        for (ours, theirs) in
            [("weights_", "weights_"), ("means_", "means_"), (covariances, "covariances")]
        {
            let found: ArrayD<f64> = root.require(ours).unwrap().array().unwrap();
            assert_eq!(found, expected.f64(theirs).unwrap());
        }
        assert_eq!(root.require("n_components").unwrap().int().unwrap(), 2);
        assert_eq!(root.require("covariance_type").unwrap().text().unwrap(), "full");
    }
}

#[test]
fn numbers_and_lists_become_arrays() {
    let array = |source: &[u8]| parse(source).unwrap().root().array::<f64>().unwrap();
    assert_eq!(array(b"I42\n."), ndarray::arr0(42.0).into_dyn());
    assert_eq!(array(b"L-3L\n."), ndarray::arr0(-3.0).into_dyn());
    assert_eq!(array(b"F1e-05\n."), ndarray::arr0(1e-5).into_dyn());
    assert_eq!(array(b"\x80\x02\x8a\x02\xff\xfe."), ndarray::arr0(-257.0).into_dyn());
    assert_eq!(array(b"((I1\nI2\nt(I3\nF4.5\nll."), array![[1.0, 2.0], [3.0, 4.5]].into_dyn());
    assert_eq!(array(b"(l."), ndarray::Array1::<f64>::zeros(0).into_dyn());
    for ragged in [&b"((I1\nI2\nt(I3\nll."[..], b"(I1\nNl.", b"L99999999999999999999L\n."] {
        assert!(parse(ragged).unwrap().root().array::<f64>().is_err());
    }
    assert!(parse(b"I-1\n.").unwrap().root().array::<u32>().is_err());
}

#[test]
fn a_later_entry_replaces_an_earlier_one() {
    let pickle = parse(b"(S'a'\nI1\nS'b'\nI2\ndS'a'\nI3\ns.").unwrap();
    assert_eq!(pickle.root().require("a").unwrap().int().unwrap(), 3);
    assert_eq!(pickle.root().keys(), ["a", "b", "a"]);
    let message = pickle.root().require("c").err().unwrap().to_string();
    assert!(message.contains("`c`: missing"), "{message}");
}

#[test]
fn programs_that_are_not_data_are_refused() {
    for (source, expected) in [
        (&b""[..], "the file is empty"),
        (b"N", "unexpected end"),
        (b".", "stack is empty"),
        (b"(.", "stack is empty"),
        (b"(1.", "stack is empty"),
        (b"\x80\x06N.", "protocol 6"),
        (b"P1\n.", "outside the file"),
        (b"NQ.", "outside the file"),
        (b"\x82\x01.", "registered number"),
        (b"\x97.", "buffers"),
        (b"g7\n.", "memo 7 was never written"),
        (b"cos\nsystem\n(S'x'\ntR.", "`os.system`"),
        (b"(ios\nsystem\n.", "`os.system`"),
        (b"\x8c\x02os\x8c\x06system\x93.", "`os.system`"),
        (b"NN\x93.", "not a string"),
        (b"N)R.", "not a class"),
        (b"N)}\x92.", "not a class"),
        (b"c__builtin__\nset\n)}NNs\x92.", "keyword arguments"),
        (b"ccopy_reg\n_reconstructor\n)R.", "without a class"),
        (b"Nb.", "the stack is empty"),
        (b"NNb.", "not an object"),
        (b"NNa.", "not a list"),
        (b"](NNu.", "not a dictionary"),
        (b"}(Nu.", "a key without a value"),
        (b"\x8e\xff\xff\xff\xff\xff\xff\xff\x7f.", "unexpected end"),
        (b"X\xff\xff\xff\x7f.", "unexpected end"),
        (b"T\xff\xff\xff\xff.", "negative length"),
        (b"S'a.", "ends inside a line"),
        (b"S'a\n.", "without quotes"),
        (b"Ix\n.", "`x` is not an integer"),
        (b"\x00", "unknown instruction 0x00"),
    ] {
        let message = match parse(source) {
            Ok(_) => panic!("{source:?} was read"),
            Err(error) => error.to_string(),
        };
        assert!(message.contains(expected), "{source:?}: {message}");
    }
}

#[test]
fn memory_stays_in_proportion() {
    // A list of one array 1000 times: 8 MB of numbers from 200 kB of file.
    let bytes = vec![7u8; 100_000];
    let mut source =
        b"\x80\x02cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R(\
                       K\x01J"
            .to_vec();
    source.extend((bytes.len() as i32).to_le_bytes());
    source.extend(b"\x85cnumpy\ndtype\nU\x02u1K\x00K\x01\x87RK\x00T");
    source.extend((bytes.len() as i32).to_le_bytes());
    source.extend(&bytes);
    source.extend(b"tbq\x000](");
    source.extend(b"h\x00".repeat(1000));
    source.extend(b"e.");
    let pickle = parse(&source).unwrap();
    let root = pickle.root();
    assert_eq!(root.elements().unwrap()[0].array::<f64>().unwrap().len(), bytes.len());
    let message = root.array::<f64>().unwrap_err().to_string();
    assert!(message.contains("exceed the memory limit"), "{message}");

    // Nested lists, each referenced twice: 2³⁰ visits of empty lists.
    let mut doubled = b"]q\x00".to_vec();
    for level in 0..30u8 {
        doubled.extend([b"](h".as_slice(), &[level], b"h", &[level], b"eq", &[level + 1]].concat());
    }
    doubled.push(b'.');
    let message = parse(&doubled).unwrap().root().array::<f64>().unwrap_err().to_string();
    assert!(message.contains("exceed the memory limit"), "{message}");
    let holds_itself = [b"]q\x00(".to_vec(), b"h\x00".repeat(200_000), b"e.".to_vec()].concat();
    assert!(parse(&holds_itself).unwrap().root().array::<f64>().is_err());
    let memos = [b"N".to_vec(), b"\x94".repeat(5000), b".".to_vec()].concat();
    assert!(parse(&memos).is_err());

    // Unused objects count towards the limit.
    assert!(parse(&b"]".repeat(1 << 20)).is_err());
    let deep = [b"]".repeat(60_000), b"a".repeat(59_999), b".".to_vec()].concat();
    let message = parse(&deep).unwrap().root().array::<f64>().unwrap_err().to_string();
    assert!(message.contains("nested arrays"), "{message}");
}

#[test]
fn a_list_that_holds_itself_ends() {
    let pickle = parse(b"]q\x00h\x00a.").unwrap();
    assert!(pickle.root().array::<f64>().is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn no_bytes_make_the_reader_panic(bytes: Vec<u8>) {
        if let Ok(pickle) = parse(&bytes) {
            exercise(&pickle);
        }
    }

    #[test]
    fn no_instructions_make_the_reader_panic(
        codes in prop::collection::vec(
            prop::sample::select(vec![
                &b"("[..], b"0", b"2", b"N", b"K\x02", b"K\x00", b"G\x3f\xf0\0\0\0\0\0\0", b"U\x02f8", b"U\x01<",
                b"U\x10abcdefghijklmnop", b"]", b"}", b")", b"l", b"t", b"\x85", b"\x86", b"\x87", b"d", b"a",
                b"e", b"s", b"u", b"q\x00", b"h\x00", b"q\x01", b"h\x01", b"R", b"\x81", b"b",
                b"cnumpy.core.multiarray\n_reconstruct\n", b"cnumpy\nndarray\n", b"cnumpy\ndtype\n",
                b"cscipy.sparse.csr\ncsr_matrix\n", b"cchumpy.reordering\nSelect\n",
                b"c_codecs\nencode\n", b"X\x01\0\0\0a", b"U\x04data", b"U\x06_shape", b"U\x01x",
            ]),
            0..60,
        ),
    ) {
        let mut source = codes.concat();
        source.push(b'.');
        if let Ok(pickle) = parse(&source) {
            exercise(&pickle);
        }
    }

    #[test]
    fn no_changed_file_makes_the_reader_panic(
        file: prop::sample::Index,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let paths: Vec<_> = named("").into_iter().filter(|p| p.extension().unwrap() == "pkl").collect();
        let mut bytes = fs::read(file.get(&paths)).unwrap();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(pickle) = parse(&bytes) {
            exercise(&pickle);
            let root = pickle.root();
            for name in ["v_template", "shapedirs", "posedirs", "J_regressor", "weights", "f"] {
                if let Some(value) = root.get(name) {
                    let _ = (value.array::<f64>(), value.sparse());
                }
            }
        }
    }
}
