//! What is fuzzed: readers of bytes that anybody may have written. None may panic, and each keeps what it promises besides.

use std::sync::LazyLock;

use union3d::log::fuzzing;
use union3d::toolpath::{Dialect, Interpreter, Options};
use union3d::wire::convert::Settings;
use union3d::wire::decode;
use union3d::wire::problem::{Code, Problem};

/// A reader under test: asserts that all is well with some bytes.
pub(crate) type Target = fn(&[u8]);

/// All of them, by name: that of their corpus too.
const TARGETS: [(&str, Target); 4] = [
    ("decode", decode_body),
    ("codec", fuzzing::codec),
    ("wal", fuzzing::wal),
    ("moves", moves),
];

/// The one of this name.
/// # Panics
/// When there is none.
pub(crate) fn target(name: &str) -> Target {
    let (_, target) = TARGETS
        .into_iter()
        .find(|(own, _)| *own == name)
        .expect("the name of a target");
    target
}

const CUBES_MAX: usize = 50;

/// Loops that move are not endless by themselves, so somebody else must end them.
const EVENTS_MAX: usize = 20_000;

static SETTINGS: LazyLock<Settings> = LazyLock::new(|| {
    let body = br#"{"edge":3,"steps_per_unit":10,"rounding":"nearest","anchor":"center"}"#;
    decode::settings(body).expect("settings without a fault")
});

/// Bodies of requests. The first byte says of which: a change, a line, a message, settings, or a revert.
fn decode_body(bytes: &[u8]) {
    let Some((kind, body)) = bytes.split_first() else {
        return;
    };
    match kind {
        b'c' => change(body),
        b'l' => refused_well(decode::line(body, &SETTINGS)),
        b'm' => refused_well(decode::message(body, &SETTINGS, CUBES_MAX)),
        b's' => refused_well(decode::settings(body)),
        _ => refused_well(decode::revert(body)),
    }
}

/// A body that one of the two readers takes means the same to the other; only the slow one looks for ids at two places.
fn change(body: &[u8]) {
    let fast = decode::change(body, &SETTINGS, CUBES_MAX);
    let slow = decode::change_faults(body, &SETTINGS, CUBES_MAX);
    match (&fast, &slow) {
        (Ok(fast), Ok(slow)) => assert_eq!(format!("{fast:?}"), format!("{slow:?}")),
        (Err(fast), Ok(_)) => panic!("refused at first: {fast:?}"),
        (_, Err(slow)) => assert_ne!(slow.code(), Code::Internal),
    }
    refused_well(fast);
}

fn refused_well<T>(read: Result<T, Problem>) {
    if let Err(problem) = read {
        assert_ne!(problem.code(), Code::Internal, "{problem:?}");
    }
}

/// A program is run to its end or to its fault, and nothing comes after that. A first line `#NAME` says for which controller it is
/// written.
fn moves(bytes: &[u8]) {
    let named = Dialect::ALL.into_iter().find_map(|dialect| {
        let rest = bytes.strip_prefix(b"#")?;
        let rest = rest.strip_prefix(dialect.name().as_bytes())?;
        Some((dialect, rest.strip_prefix(b"\n")?))
    });
    let bytes = named.map_or(bytes, |(_, rest)| rest);
    let options = Options {
        dialect: named.map(|(dialect, _)| dialect),
        ..Options::default()
    };
    let mut moves = Interpreter::new(bytes, options);
    let mut has_failed = false;
    let mut events = 0;
    for event in moves.by_ref().take(EVENTS_MAX) {
        assert!(!has_failed, "something comes after an error");
        has_failed = event.is_err();
        events += 1;
    }
    assert!(events == EVENTS_MAX || moves.next().is_none());
    assert!(moves.bytes() <= bytes.len() as u64);
}
