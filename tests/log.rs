//! The log against a plain map of cubes: whatever is appended, snapshotted, trimmed, reopened, cut or flipped, what comes back is
//! what was appended, a whole earlier part of it that is announced as such, or a refusal.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::collections::BTreeMap;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use union3d::geometry::{Bounds, CubeId, Edge, Effect, Place, Stock, StockMeasures, Totals};
use union3d::log::{
    Header, HistoryRow, Keep, KeyRecord, LogError, Motion, Record, RecordedOutcome, Replayed,
    SceneLog, Seq, Step, TEMPORARY_PREFIX, remove_leftovers, remove_scene,
};

#[path = "oracle/random.rs"]
mod random;

const EDGE: u32 = 5;
const KEEP: Keep = Keep {
    history_changes_max: 1000,
    idempotency_keys_max: 1000,
    revert_changes_max: 0,
    revert_bytes_max: 0,
    snapshot_log_bytes_min: 16 << 20,
    write_ahead_pages_max: 1000,
};

type Cubes = BTreeMap<CubeId, Place>;

/// Random numbers as this file wants them.
struct Random(random::Random);

impl Random {
    fn new(seed: u64) -> Self {
        Self(random::Random::new(seed))
    }

    fn next(&mut self) -> u64 {
        self.0.next()
    }

    fn below(&mut self, end: usize) -> usize {
        usize::try_from(self.0.below(end as u64)).unwrap()
    }

    fn place(&mut self) -> Place {
        let corner = [(); 3].map(|()| self.0.within(-1_000_000, 999_999));
        Place::new(corner, Edge::new(i64::from(EDGE)).unwrap()).unwrap()
    }
}

/// Totals mean nothing to the log; these are different for every seq and number of cubes.
fn totals(seq: u64, cubes: &Cubes) -> Totals {
    let mut totals = Totals {
        cubes: u64::try_from(cubes.len()).unwrap(),
        ..Totals::default()
    };
    totals.measures.volume = i128::from(seq) * -123_456_789_012_345_678_901;
    totals.measures.first_moments2[1] = i128::from(seq) << 90;
    totals.measures.second_moments3[2] = ethnum::I256::from(-1_i64 << 62) * i128::from(seq);
    totals.measures.vertices[3] = i64::try_from(seq).unwrap();
    if seq % 2 == 1 {
        let mut part = StockMeasures {
            removed: totals.measures,
            remaining: totals.measures,
        };
        part.remaining.volume = -1;
        part.remaining.euler8 = i64::MIN;
        totals.stock = Some(part);
    }
    totals.bounds = cubes.values().next().map(|place| Bounds {
        min: place.corner(),
        max: place.corner(),
    });
    totals
}

/// Some changes say what they belong to, some in part, some not; numbers on both sides of where a signed one ends.
fn motion(seq: u64) -> Motion {
    Motion {
        number: (!seq.is_multiple_of(3)).then_some((1 << 63) + 40 - 2 * seq),
        duration_ns: (!seq.is_multiple_of(4)).then_some(seq << 40),
    }
}

fn stock() -> Stock {
    Stock::new([-5, 0, 7], [1 << 30, 1, 8]).unwrap()
}

/// What the log should hold: the reference.
#[derive(Clone, Default)]
struct Model {
    /// Cubes after every seq, from 0.
    states: Vec<Cubes>,
    rows: Vec<HistoryRow>,
    keys: Vec<KeyRecord>,
}

impl Model {
    fn new() -> Self {
        Self {
            states: vec![Cubes::new()],
            ..Self::default()
        }
    }

    fn seq(&self) -> u64 {
        u64::try_from(self.states.len()).unwrap() - 1
    }

    fn cubes(&self) -> &Cubes {
        self.states.last().unwrap()
    }

    fn totals(&self) -> Totals {
        totals(self.seq(), self.cubes())
    }

    fn record(&mut self, effect: Effect) -> Record {
        let mut cubes = self.cubes().clone();
        apply(&mut cubes, &effect);
        let seq = self.seq() + 1;
        let record = Record {
            seq: Seq(seq),
            at_ms: 1_700_000_000_000 + seq * seq,
            reverts_to: None,
            motion: motion(seq),
            volume_removed: (i128::from(seq) - 7) << (seq % 80),
            totals: totals(seq, &cubes),
            effect,
        };
        self.rows.push(HistoryRow {
            seq: record.seq,
            at_ms: record.at_ms,
            inserted: u64::try_from(record.effect.inserted.len()).unwrap(),
            deleted: u64::try_from(record.effect.deleted.len()).unwrap(),
            motion: record.motion,
            volume_removed: record.volume_removed,
            totals: record.totals,
        });
        self.states.push(cubes);
        record
    }

    /// Some deletions, moves and insertions.
    fn random_record(&mut self, random: &mut Random, operations_max: usize) -> Record {
        let mut effect = Effect::default();
        let mut cubes = self.cubes().clone();
        for _ in 0..random.below(operations_max + 1) {
            let old = cubes
                .iter()
                .nth(random.below(cubes.len() * 2 + 1))
                .map(|(&id, &place)| (id, place));
            if let Some((id, place)) = old {
                cubes.remove(&id);
                effect.deleted.push((id, place));
                if random.below(3) == 0 {
                    effect.inserted.push((id, random.place()));
                }
            } else {
                let id = CubeId(random.next() >> random.below(64));
                let there = |list: &[(CubeId, Place)]| list.iter().any(|&(other, _)| other == id);
                if !self.cubes().contains_key(&id) && !there(&effect.inserted) {
                    effect.inserted.push((id, random.place()));
                }
            }
        }
        self.record(effect)
    }

    fn key(&mut self, random: &mut Random) -> KeyRecord {
        let number = self.keys.len();
        let record = KeyRecord {
            key: format!("key {number}").into(),
            body: [(); 32].map(|()| random.next().to_le_bytes()[0]),
            answer: RecordedOutcome {
                seq: Seq(self.seq()),
                at_ms: random.next(),
                inserted: random.next(),
                deleted: 3,
                unchanged: 0,
                assigned: number
                    .is_multiple_of(2)
                    .then(|| (CubeId(random.next()), CubeId(u64::MAX))),
                volume_removed: -i128::from(random.next()),
                totals: self.totals(),
            },
        };
        self.keys.push(record.clone());
        record
    }
}

/// What makes one set of cubes another.
fn difference(from: &Cubes, to: &Cubes) -> Effect {
    let only_in = |one: &Cubes, other: &Cubes| {
        let only = one
            .iter()
            .filter(|(id, place)| other.get(id) != Some(place));
        only.map(|(id, place)| (*id, *place)).collect()
    };
    Effect {
        deleted: only_in(from, to),
        inserted: only_in(to, from),
    }
}

fn apply(cubes: &mut Cubes, effect: &Effect) {
    for (id, place) in &effect.deleted {
        assert_eq!(cubes.remove(id), Some(*place));
    }
    for (id, place) in &effect.inserted {
        assert_eq!(cubes.insert(*id, *place), None);
    }
}

/// A directory in memory where there is one: thousands of syncs are then no matter.
fn directory() -> TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() {
        TempDir::new_in(memory).unwrap()
    } else {
        TempDir::new().unwrap()
    }
}

fn header() -> Header {
    Header {
        incarnation: 0xFEDC_BA98_7654_3210,
        edge_steps: EDGE,
        stock: Some(stock()),
        settings: r#"{"edge":5,"unit":"µm"}"#.to_owned(),
    }
}

fn create(data: &TempDir, keep: Keep) -> (SceneLog, PathBuf) {
    let path = data.path().join("scene");
    (SceneLog::create(&path, &header(), keep).unwrap(), path)
}

/// Opens and replays, checking order and totals on the way.
fn reopen(path: &Path, keep: Keep) -> Result<(SceneLog, Cubes, Vec<String>), LogError> {
    let (mut log, notices) = SceneLog::open(path, keep)?;
    assert_eq!(log.header(), &header());
    let mut cubes = Cubes::new();
    let mut seq = Seq(0);
    let mut told = vec![];
    let mut begun = None;
    log.replay(&mut |thousandths| told.push(thousandths), &mut |replayed| {
        let expected = match replayed {
            Replayed::SnapshotBegin { cubes: there } => {
                assert_eq!((begun, cubes.len()), (None, 0));
                begun = Some(there);
                return true;
            }
            Replayed::Cubes(chunk) => {
                assert!(chunk.len() <= 65_536);
                for &(id, place) in chunk {
                    assert_eq!(cubes.insert(id, place), None);
                }
                return true;
            }
            Replayed::SnapshotEnd {
                seq: at,
                totals,
                next_id,
                at_ms,
            } => {
                assert_eq!((seq, at_ms, next_id), (Seq(0), at.0 + 7, at.0 + 9));
                assert_eq!(begun, Some(cubes.len() as u64));
                seq = at;
                *totals
            }
            Replayed::Change(record) => {
                assert_eq!(record.seq.0, seq.0 + 1);
                seq = record.seq;
                apply(&mut cubes, &record.effect);
                record.totals
            }
        };
        expected == totals(seq.0, &cubes)
    })?;
    assert_eq!(seq, log.seq());
    assert_eq!((told.first(), told.last()), (Some(&0), Some(&1000)));
    assert!(told.is_sorted_by(|a, b| a < b));
    Ok((log, cubes, notices))
}

/// Reopens a log that must be in order and hold what the model does.
#[track_caller]
fn check(path: &Path, keep: Keep, model: &Model) -> SceneLog {
    let (mut log, cubes, notices) = reopen(path, keep).unwrap();
    assert_eq!(notices, Vec::<String>::new());
    assert_eq!(log.seq(), Seq(model.seq()));
    assert_eq!(&cubes, model.cubes());
    check_rows(&mut log, model).unwrap();
    log
}

fn check_rows(log: &mut SceneLog, model: &Model) -> Result<(), LogError> {
    let history = log.history()?;
    let (oldest, newest) = history.range()?;
    assert_eq!(newest, log.seq());
    let mut found = history.rows(oldest, newest, usize::MAX)?;
    if oldest == Seq(0) {
        let empty = found.remove(0);
        assert_eq!(
            (empty.seq, empty.totals, empty.at_ms),
            (Seq(0), Totals::of_nothing(Some(stock())), log.created_ms())
        );
    }
    let newest = usize::try_from(newest.0).unwrap();
    assert_eq!(found, model.rows[newest - found.len()..newest]);
    Ok(())
}

fn write_snapshot(log: &mut SceneLog, model: &Model, random: &mut Random) {
    begin_snapshot(log, model);
    add_to_snapshot(log, model.cubes(), random);
    log.snapshot_finish().unwrap();
}

fn begin_snapshot(log: &mut SceneLog, model: &Model) {
    let seq = model.seq();
    log.snapshot_begin(seq + 7, &model.totals(), seq + 9)
        .unwrap();
}

fn add_to_snapshot(log: &mut SceneLog, cubes: &Cubes, random: &mut Random) {
    let cubes: Vec<_> = cubes.iter().map(|(&id, &place)| (id, place)).collect();
    let mut rest = &cubes[..];
    while !rest.is_empty() {
        let (part, behind) = rest.split_at(1 + random.below(rest.len()));
        log.snapshot_add(part).unwrap();
        rest = behind;
    }
}

fn trim_all(log: &mut SceneLog) {
    while log.trim().unwrap() {}
    assert!(!log.wants_trim());
}

#[test]
fn sqlite_does_not_lose_commits_of_two_connections() {
    // 3.7.0 to 3.51.2 could: https://sqlite.org/wal.html#walresetbug
    assert!(rusqlite::version_number() >= 3_051_003);
}

/// However often one has gone to and fro, the way to another state leads over the changes that tell the two apart, and each of
/// them once.
#[test]
fn the_way_to_a_state_leads_over_what_tells_it_apart() {
    for seed in 1..=8 {
        let mut random = Random::new(seed);
        let data = directory();
        let mut model = Model::new();
        let (mut log, path) = create(&data, KEEP);
        // Where each state comes from: the state before, and the first one that was the same.
        let (mut before, mut origin) = (vec![0], vec![0]);
        for seq in 1..60 {
            let back_to = random.below(seq);
            let mut record = if random.below(3) == 0 {
                let effect = difference(model.cubes(), &model.states[back_to]);
                origin.push(origin[back_to]);
                Record {
                    reverts_to: Some(Seq(back_to as u64)),
                    ..model.record(effect)
                }
            } else {
                origin.push(seq);
                model.random_record(&mut random, 8)
            };
            before.push(origin[seq - 1]);
            record.at_ms = model.rows[seq - 1].at_ms;
            log.append(&[record], &[]).unwrap();
            if random.below(10) == 0 {
                drop(log);
                log = check(&path, KEEP, &model);
            }
            for _ in 0..3 {
                let to = random.below(seq + 1);
                let steps = check_way(&log, &model, to);
                let ancestors = |of: usize| {
                    let first = origin[of];
                    std::iter::successors(Some(first), |at| (*at > 0).then(|| before[*at]))
                        .collect::<std::collections::BTreeSet<_>>()
                };
                let apart = ancestors(seq).symmetric_difference(&ancestors(to)).count();
                assert_eq!(steps, apart, "from {seq} to {to}");
            }
        }
    }
}

/// Goes the way from the newest state to that at `to`, and says in how many steps.
#[track_caller]
fn check_way(log: &SceneLog, model: &Model, to: usize) -> usize {
    let mut cubes = model.cubes().clone();
    let mut steps = 0;
    log.way_to(Seq(to as u64), &mut |step| {
        steps += 1;
        match step {
            Step::Redo(effect) => apply(&mut cubes, effect),
            Step::Undo(Effect { deleted, inserted }) => apply(
                &mut cubes,
                &Effect {
                    deleted: inserted.clone(),
                    inserted: deleted.clone(),
                },
            ),
        }
    })
    .unwrap();
    assert_eq!(cubes, model.states[to], "from {:?} to {to}", log.seq());
    steps
}

/// What a revert went back to may have been dropped since, and all that led there: the way does not lead over it.
#[test]
fn the_way_to_a_state_does_not_lead_over_what_was_dropped() {
    let data = directory();
    let mut random = Random::new(7);
    let keep = Keep {
        revert_changes_max: 3,
        revert_bytes_max: u64::MAX,
        ..KEEP
    };
    let (mut log, _) = create(&data, keep);
    let mut model = Model::new();
    for seq in 1..=6 {
        let record = if seq == 4 {
            let effect = difference(model.cubes(), &model.states[1]);
            Record {
                reverts_to: Some(Seq(1)),
                ..model.record(effect)
            }
        } else {
            model.random_record(&mut random, 8)
        };
        log.append(&[record], &[]).unwrap();
    }
    write_snapshot(&mut log, &model, &mut random);
    trim_all(&mut log);
    assert_eq!(log.oldest_reachable(), Seq(3));
    for to in 3..=6 {
        assert_eq!(check_way(&log, &model, to), 6 - to);
    }
}

/// As many of the newest operations are kept as fit into so many bytes.
#[test]
fn operations_are_kept_up_to_the_limit_of_their_bytes() {
    let sizes = |path: &Path| {
        let connection = rusqlite::Connection::open(path.join("scene.sqlite")).unwrap();
        let mut statement = connection
            .prepare("SELECT length(cubes) FROM operations ORDER BY seq")
            .unwrap();
        let sizes = statement.query_map([], |row| row.get::<_, i64>(0)).unwrap();
        sizes
            .map(|size| size.unwrap().cast_unsigned())
            .collect::<Vec<_>>()
    };
    // The last three fit exactly; of a byte less only two do.
    for (less, oldest) in [(0, 3), (1, 4)] {
        let data = directory();
        let mut random = Random::new(8);
        let (mut log, path) = create(&data, KEEP);
        let mut model = Model::new();
        for _ in 1..=6 {
            log.append(&[model.random_record(&mut random, 8)], &[])
                .unwrap();
        }
        drop(log);
        let newest: u64 = sizes(&path)[3..].iter().sum();
        let keep = Keep {
            revert_changes_max: u64::MAX,
            revert_bytes_max: newest - less,
            ..KEEP
        };
        let (mut log, ..) = reopen(&path, keep).unwrap();
        write_snapshot(&mut log, &model, &mut random);
        trim_all(&mut log);
        assert_eq!(log.oldest_reachable(), Seq(oldest));
        drop(log);
        check(&path, keep, &model);
    }
}

#[test]
fn random_histories_come_back() {
    for seed in 1..=12 {
        let mut random = Random::new(seed);
        let data = directory();
        let keep = Keep {
            history_changes_max: u64::try_from(random.below(40)).unwrap(),
            idempotency_keys_max: u64::try_from(random.below(10)).unwrap(),
            revert_changes_max: u64::try_from(random.below(30)).unwrap(),
            revert_bytes_max: u64::try_from(random.below(4000)).unwrap(),
            snapshot_log_bytes_min: 16 << 20,
            write_ahead_pages_max: 1000,
        };
        let (mut log, path) = create(&data, keep);
        let mut model = Model::new();
        let mut under_way = None;
        for _ in 0..150 {
            match random.below(12) {
                0 => {
                    begin_snapshot(&mut log, &model);
                    under_way = Some(model.cubes().clone());
                }
                1 => {
                    if let Some(cubes) = under_way.take() {
                        add_to_snapshot(&mut log, &cubes, &mut random);
                        log.snapshot_finish().unwrap();
                    }
                }
                2 => drop(log.trim().unwrap()),
                3 => trim_all(&mut log),
                4 => {
                    drop(log);
                    log = check(&path, keep, &model);
                    under_way = None;
                }
                5 => log.probe().unwrap(),
                _ => {
                    let records: Vec<_> = (0..random.below(4))
                        .map(|_| {
                            let operations_max = [0, 1, 3, 300][random.below(4)];
                            model.random_record(&mut random, operations_max)
                        })
                        .collect();
                    let keys: Vec<_> = (0..random.below(3))
                        .map(|_| model.key(&mut random))
                        .collect();
                    log.append(&records, &keys).unwrap();
                }
            }
            assert_eq!(log.seq(), Seq(model.seq()));
            check_rows(&mut log, &model).unwrap();
        }
        trim_all(&mut log);
        drop(log);
        let log = check(&path, keep, &model);
        let kept = usize::try_from(keep.idempotency_keys_max).unwrap();
        let forgotten = model.keys.len().saturating_sub(kept);
        for (number, record) in model.keys.iter().enumerate() {
            let expected = (number >= forgotten).then(|| record.clone());
            assert_eq!(log.key(&record.key).unwrap(), expected);
        }
    }
}

#[test]
fn history_keeps_the_newest_and_what_replay_needs() {
    let data = directory();
    let keep = Keep {
        history_changes_max: 3,
        ..KEEP
    };
    let (mut log, path) = create(&data, keep);
    let mut random = Random::new(1);
    let mut model = Model::new();
    let history = log.history().unwrap();
    assert_eq!(history.range().unwrap(), (Seq(0), Seq(0)));
    assert_eq!(
        history.at(Seq(0)).unwrap().unwrap().totals,
        Totals::of_nothing(Some(stock()))
    );
    assert_eq!(history.at(Seq(1)).unwrap(), None);
    let records: Vec<_> = (0..8)
        .map(|_| model.random_record(&mut random, 3))
        .collect();
    log.append(&records, &[]).unwrap();
    trim_all(&mut log);
    // Without a snapshot every change is needed.
    assert_eq!(history.range().unwrap(), (Seq(0), Seq(8)));
    write_snapshot(&mut log, &model, &mut random);
    assert!(log.wants_trim());
    trim_all(&mut log);
    assert_eq!(history.range().unwrap(), (Seq(6), Seq(8)));
    assert_eq!(history.at(Seq(5)).unwrap(), None);
    assert_eq!(history.at(Seq(0)).unwrap(), None);
    assert_eq!(history.at(Seq(6)).unwrap().as_ref(), Some(&model.rows[5]));
    assert_eq!(
        history.rows(Seq(0), Seq(u64::MAX), 2).unwrap(),
        model.rows[5..7]
    );
    assert_eq!(history.rows(Seq(7), Seq(7), 9).unwrap(), model.rows[6..7]);
    assert_eq!(history.rows(Seq(8), Seq(7), 9).unwrap(), []);
    assert_eq!(history.rows(Seq(7), Seq(8), 0).unwrap(), []);
    drop(log);
    check(&path, keep, &model);
}

/// Keys alone are worth a trim, once many of them are past the limit.
#[test]
fn old_keys_alone_are_dropped() {
    let data = directory();
    let keep = Keep {
        idempotency_keys_max: 10,
        ..KEEP
    };
    let (mut log, path) = create(&data, keep);
    let mut random = Random::new(2);
    let mut model = Model::new();
    let record = model.random_record(&mut random, 3);
    let keys: Vec<_> = (0..2000).map(|_| model.key(&mut random)).collect();
    let (few, more) = keys.split_at(20);
    log.append(&[record], few).unwrap();
    assert!(!log.wants_trim(), "ten keys are not worth it");
    log.append(&[], more).unwrap();
    assert!(log.wants_trim());
    trim_all(&mut log);
    let kept = |log: &SceneLog| {
        keys.iter()
            .filter(|record| log.key(&record.key).unwrap().is_some())
            .count()
    };
    assert_eq!(kept(&log), 10);
    drop(log);
    let log = check(&path, keep, &model);
    assert_eq!(kept(&log), 10);
}

/// Few of many rows by the index, and most of them without it.
#[test]
fn rows_are_found_by_the_numbers_of_their_moves() {
    let data = directory();
    let (mut log, _) = create(&data, KEEP);
    let mut random = Random::new(2);
    let mut model = Model::new();
    for _ in 0..10 {
        let records: Vec<_> = (0..50)
            .map(|_| model.random_record(&mut random, 1))
            .collect();
        log.append(&records, &[]).unwrap();
    }
    let history = log.history().unwrap();
    let numbers = [
        0,
        1,
        (1 << 63) - 900,
        (1 << 63) - 40,
        1 << 63,
        (1 << 63) + 30,
        u64::MAX,
    ];
    for _ in 0..300 {
        let mut pick = || numbers[random.below(numbers.len())].saturating_add(random.next() % 60);
        let moves = [pick(), pick()];
        let (from, to) = (Seq(random.next() % 400), Seq(random.next() % 600));
        let limit = [1, 7, usize::MAX][random.below(3)];
        let expected: Vec<_> = model
            .rows
            .iter()
            .filter(|row| (from..=to).contains(&row.seq))
            .filter(|row| {
                let number = row.motion.number;
                number.is_some_and(|number| (moves[0]..=moves[1]).contains(&number))
            })
            .take(limit)
            .cloned()
            .collect();
        let found = history.rows_of_moves(from, to, moves, limit).unwrap();
        assert_eq!(found, expected, "{from:?} {to:?} {moves:?} {limit}");
    }
}

#[test]
fn a_scene_is_created_whole_and_removed_whole() {
    let data = directory();
    let (log, path) = create(&data, KEEP);
    assert!(log.size_bytes() > 4096);
    assert!(SceneLog::create(&path, &header(), KEEP).is_err());
    // What a crash in the middle leaves.
    let rubbish = data.path().join(format!("{TEMPORARY_PREFIX}create-other"));
    fs::create_dir(&rubbish).unwrap();
    fs::write(rubbish.join("scene.sqlite"), "half").unwrap();
    let names = || fs::read_dir(data.path()).unwrap().count();
    assert_eq!(names(), 2);
    drop(SceneLog::create(&data.path().join("other"), &header(), KEEP).unwrap());
    assert_eq!(
        names(),
        2,
        "the rubbish of the same scene is in nobody's way"
    );
    fs::create_dir(&rubbish).unwrap();
    remove_leftovers(data.path()).unwrap();
    assert_eq!(names(), 2);
    drop(log);
    check(&path, KEEP, &Model::new());
    remove_scene(&path).unwrap();
    assert_eq!(names(), 1);
    assert!(SceneLog::create(&data.path().join("no/such"), &header(), KEEP).is_err());
}

#[test]
fn what_is_no_log_is_refused() {
    let data = directory();
    let refuse = |path: &Path| SceneLog::open(path, KEEP).map(drop).unwrap_err();
    let path = data.path().join("scene");
    assert!(matches!(refuse(&path), LogError::Damaged { .. }));
    fs::create_dir(&path).unwrap();
    let database = path.join("scene.sqlite");
    for content in [&b""[..], b"text", &[0; 9000]] {
        fs::write(&database, content).unwrap();
        refuse(&path);
        assert_eq!(fs::read(&database).unwrap(), content, "it is left alone");
    }
    fs::remove_file(&database).unwrap();
    let other = rusqlite::Connection::open(&database).unwrap();
    other.execute_batch("CREATE TABLE t(a)").unwrap();
    drop(other);
    assert!(matches!(refuse(&path), LogError::Foreign { .. }));
    drop(SceneLog::create(&data.path().join("newer"), &header(), KEEP).unwrap());
    let newer = rusqlite::Connection::open(data.path().join("newer/scene.sqlite")).unwrap();
    newer.pragma_update(None, "user_version", 4).unwrap();
    drop(newer);
    let error = refuse(&data.path().join("newer"));
    assert!(
        matches!(error, LogError::Newer { format: 4, .. }),
        "{error}"
    );
    let error = error.to_string();
    assert!(error.contains("format 4, this program knows 3"), "{error}");
}

#[test]
fn a_state_that_differs_is_damage_with_its_seq() {
    let data = directory();
    let (mut log, path) = create(&data, KEEP);
    let mut random = Random::new(1);
    let mut model = Model::new();
    let records: Vec<_> = (0..5)
        .map(|_| model.random_record(&mut random, 3))
        .collect();
    log.append(&records, &[]).unwrap();
    drop(log);
    let (mut log, _) = SceneLog::open(&path, KEEP).unwrap();
    let error = log
        .replay(
            &mut |_| {},
            &mut |replayed| !matches!(replayed, Replayed::Change(record) if record.seq == Seq(3)),
        )
        .unwrap_err();
    assert!(matches!(error, LogError::Damaged { seq: Seq(3), .. }));
    assert!(error.to_string().contains("from a backup"), "{error}");
}

#[test]
fn a_snapshot_takes_at_most_20_bytes_a_cube_and_the_log_becomes_shorter() {
    let data = directory();
    let (mut log, path) = create(&data, KEEP);
    let mut random = Random::new(3);
    let mut model = Model::new();
    let count = 200_000;
    let inserted: Vec<_> = (0..count)
        .map(|_| (CubeId(random.next()), random.place()))
        .collect();
    log.append(
        &[model.record(Effect {
            deleted: vec![],
            inserted: inserted.clone(),
        })],
        &[],
    )
    .unwrap();
    for _ in 0..10 {
        // Everything moves away and back: 400,000 cubes a time.
        let effect = Effect {
            deleted: inserted.clone(),
            inserted: inserted.clone(),
        };
        log.append(&[model.record(effect)], &[]).unwrap();
    }
    assert!(log.wants_snapshot(count));
    assert!(!log.wants_snapshot(1 << 31));
    let sizes = || {
        let file = |name| fs::metadata(path.join(name)).map_or(0, |metadata| metadata.len());
        file("scene.sqlite") + file("scene.sqlite-wal")
    };
    drop(log);
    let mut log = check(&path, KEEP, &model);
    let before = sizes();
    write_snapshot(&mut log, &model, &mut random);
    assert!(!log.wants_snapshot(count));
    drop(log);
    let mut log = check(&path, KEEP, &model);
    let snapshot = sizes() - before;
    println!("{snapshot} bytes for {count} cubes");
    assert!(snapshot < 20 * count);
    trim_all(&mut log);
    drop(log);
    let mut log = check(&path, KEEP, &model);
    let after = sizes();
    assert!(after < snapshot * 5, "{before} bytes became {after}");
    assert!(log.verify(&mut |_| {}).unwrap() >= 11 + 4);
}

/// Files of a scene as a crash leaves them, and what they hold.
struct Crashed {
    name: &'static str,
    files: BTreeMap<String, Vec<u8>>,
    model: Model,
}

impl Crashed {
    fn of(name: &'static str, path: &Path, model: &Model) -> Self {
        let files = fs::read_dir(path)
            .unwrap()
            .map(|file| {
                let file = file.unwrap();
                let name = file.file_name().into_string().unwrap();
                (name, fs::read(file.path()).unwrap())
            })
            .collect();
        Self {
            name,
            files,
            model: model.clone(),
        }
    }

    /// The files with one of them changed, in a new directory.
    fn changed(&self, data: &TempDir, name: &str, content: Option<&[u8]>) -> PathBuf {
        let path = data.path().join("changed");
        if path.exists() {
            fs::remove_dir_all(&path).unwrap();
        }
        fs::create_dir(&path).unwrap();
        for (other, old) in &self.files {
            let content = if other == name {
                content
            } else {
                Some(&old[..])
            };
            if let Some(content) = content {
                fs::write(path.join(other), content).unwrap();
            }
        }
        path
    }

    /// Opens the files with one of them changed, and holds what comes out against the promise. Answers its kind.
    #[track_caller]
    fn judge(&self, data: &TempDir, name: &str, content: Option<&[u8]>) -> Outcome {
        let path = self.changed(data, name, content);
        let opened = catch_unwind(AssertUnwindSafe(|| reopen(&path, KEEP)));
        let (mut log, cubes, notices) = match opened.expect("damage is no reason to panic") {
            Ok(opened) => opened,
            Err(error) => {
                assert!(
                    matches!(error, LogError::Damaged { .. } | LogError::Foreign { .. }),
                    "damage is called damage: {error:?}"
                );
                for (file, before) in &self.files {
                    let before = if file == name {
                        content
                    } else {
                        Some(&before[..])
                    };
                    let after = fs::read(path.join(file)).ok();
                    // SQLite's index of the write-ahead file is rebuilt whenever it opens.
                    if file != "scene.sqlite-shm" && before.is_some() {
                        assert_eq!(after.as_deref(), before, "a refusal changes no file");
                    }
                }
                return Outcome::Refused;
            }
        };
        let seq = log.seq();
        assert!(seq.0 <= self.model.seq());
        assert_eq!(cubes, self.model.states[usize::try_from(seq.0).unwrap()]);
        let earlier = seq.0 < self.model.seq();
        if earlier {
            assert_eq!(name, "scene.sqlite-wal", "only its end may be lost");
            assert!(
                notices.iter().any(|notice| notice.contains(&format!(
                    "changes {} to {} were acknowledged and are lost",
                    seq.0 + 1,
                    self.model.seq()
                ))),
                "{notices:?}"
            );
        }
        match check_rows(&mut log, &self.model) {
            Ok(()) | Err(LogError::Damaged { .. }) => {}
            Err(error) => panic!("{error}"),
        }
        for record in &self.model.keys {
            if let Ok(Some(found)) = log.key(&record.key) {
                assert_eq!(&found, record);
            } else {
                assert!(!notices.is_empty(), "a key is gone without a word");
            }
        }
        if earlier {
            Outcome::Earlier(log)
        } else {
            Outcome::Exact(log)
        }
    }

    /// Whatever was damaged, what is appended afterwards is kept.
    fn go_on(&self, mut log: SceneLog, data: &TempDir) {
        let mut model = Model {
            states: self.model.states[..=usize::try_from(log.seq().0).unwrap()].to_vec(),
            ..Model::default()
        };
        let record = model.random_record(&mut Random::new(1), 9);
        log.append(&[record], &[]).unwrap();
        drop(log);
        let (log, cubes, notices) = reopen(&data.path().join("changed"), KEEP).unwrap();
        assert_eq!((log.seq(), &cubes), (Seq(model.seq()), model.cubes()));
        assert_eq!(notices, Vec::<String>::new(), "it is said once");
    }
}

#[derive(Debug)]
enum Outcome {
    Refused,
    Earlier(SceneLog),
    Exact(SceneLog),
}

/// Five ways in which a crash can leave a scene.
fn crashed_scenes() -> Vec<Crashed> {
    let mut scenes = vec![];
    let data = directory();
    let mut random = Random::new(7);
    let (mut log, path) = create(&data, KEEP);
    let mut model = Model::new();
    let mut append = |log: &mut SceneLog, model: &mut Model, changes: usize| {
        for _ in 0..changes {
            let record = model.random_record(&mut random, 6);
            let key = model.key(&mut random);
            log.append(&[record], &[key]).unwrap();
        }
    };
    append(&mut log, &mut model, 6);
    scenes.push(Crashed::of(
        "all changes in the write-ahead file",
        &path,
        &model,
    ));
    let record = model.random_record(&mut Random::new(8), 400);
    log.append(&[record], &[]).unwrap();
    write_snapshot(&mut log, &model, &mut Random::new(9));
    append(&mut log, &mut model, 4);
    let other = rusqlite::Connection::open(path.join("scene.sqlite")).unwrap();
    let checkpoint = || {
        let row = |row: &rusqlite::Row<'_>| Ok((row.get(1)?, row.get(2)?));
        let frames: rusqlite::Result<(i64, i64)> =
            other.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], row);
        frames.unwrap()
    };
    // A reader keeps what came after it from being moved.
    let reader = rusqlite::Connection::open(path.join("scene.sqlite")).unwrap();
    let transaction = reader.unchecked_transaction().unwrap();
    let _: i64 = transaction
        .query_row("SELECT count(*) FROM changes", [], |row| row.get(0))
        .unwrap();
    append(&mut log, &mut model, 5);
    let (frames, moved) = checkpoint();
    assert!(0 < moved && moved < frames);
    scenes.push(Crashed::of("part of it in the database too", &path, &model));
    drop(transaction);
    drop(reader);
    let (frames, moved) = checkpoint();
    assert_eq!(moved, frames);
    scenes.push(Crashed::of("all of it in the database too", &path, &model));
    append(&mut log, &mut model, 3);
    scenes.push(Crashed::of(
        "a write-ahead file begun anew, with old frames behind",
        &path,
        &model,
    ));
    drop(other);
    drop(log);
    let closed = Crashed::of("closed", &path, &model);
    assert!(!closed.files.contains_key("scene.sqlite-wal"));
    scenes.push(closed);
    scenes
}

/// How often what came out.
#[derive(Default, Debug)]
struct Tally {
    refused: usize,
    earlier: usize,
    exact: usize,
}

/// Judges many changes of one file and tells what came out.
fn judge_all(
    scene: &Crashed,
    file: &str,
    contents: impl Iterator<Item = Option<Vec<u8>>>,
) -> Tally {
    let data = directory();
    let mut tally = Tally::default();
    for (number, content) in contents.enumerate() {
        let log = match scene.judge(&data, file, content.as_deref()) {
            Outcome::Refused => {
                tally.refused += 1;
                continue;
            }
            Outcome::Earlier(log) => {
                tally.earlier += 1;
                log
            }
            Outcome::Exact(log) => {
                tally.exact += 1;
                log
            }
        };
        if number % 5 == 0 {
            scene.go_on(log, &data);
        }
    }
    println!("{}, {file}: {tally:?}", scene.name);
    tally
}

/// `count` copies of `bytes`, each with one byte flipped; half of them among the bytes that are not zero.
fn flips(bytes: &[u8], count: usize, seed: u64) -> impl Iterator<Item = Option<Vec<u8>>> {
    let mut random = Random::new(seed);
    let used: Vec<_> = (0..bytes.len()).filter(|&at| bytes[at] != 0).collect();
    (0..count).map(move |number| {
        let at = if number % 2 == 0 {
            random.below(bytes.len())
        } else {
            used[random.below(used.len())]
        };
        let mut flipped = bytes.to_vec();
        flipped[at] ^= 1 << random.below(8);
        Some(flipped)
    })
}

#[test]
fn flipped_bytes_never_give_a_wrong_state() {
    for scene in crashed_scenes() {
        for (file, bytes) in &scene.files {
            let count = match &**file {
                "scene.sqlite" => 500,
                "scene.sqlite-wal" => 400,
                _ => 20,
            };
            let refused = judge_all(&scene, file, flips(bytes, count, 11)).refused;
            match &**file {
                "scene.sqlite" | "scene.sqlite-wal" => {
                    assert!(refused > 0, "not one flip was seen")
                }
                _ => assert_eq!(refused, 0, "nothing depends on {file}"),
            }
        }
    }
}

#[test]
#[ignore = "half an hour: `cargo test --release --test log -- --ignored`"]
fn every_flipped_byte_never_gives_a_wrong_state() {
    for scene in crashed_scenes() {
        for (file, bytes) in &scene.files {
            let mut random = Random::new(13);
            let flipped = (0..bytes.len()).map(|at| {
                let mut flipped = bytes.clone();
                flipped[at] ^= 1 << random.below(8);
                Some(flipped)
            });
            judge_all(&scene, file, flipped);
        }
    }
}

#[test]
fn cut_files_never_give_a_wrong_state() {
    for scene in crashed_scenes() {
        for (file, bytes) in &scene.files {
            let step = match &**file {
                "scene.sqlite" => 1021,
                "scene.sqlite-wal" => 509,
                _ => 7919,
            };
            let ends = (0..=bytes.len() / FRAME_SIZE).map(|frame| 32 + frame * FRAME_SIZE);
            let lengths = (0..bytes.len()).step_by(step).chain(ends);
            let lengths = lengths.filter(|&length| length <= bytes.len());
            let cut = lengths.map(|length| Some(bytes[..length].to_vec()));
            judge_all(&scene, file, cut.chain([None]));
        }
    }
}

/// SQLite's pages are of 4096 bytes.
const FRAME_SIZE: usize = 24 + 4096;

#[test]
fn a_write_ahead_file_cut_anywhere_holds_the_whole_changes_before_the_cut() {
    let data = directory();
    let mut random = Random::new(5);
    let (mut log, path) = create(&data, KEEP);
    let mut model = Model::new();
    let file = "scene.sqlite-wal";
    let mut ends = vec![];
    for _ in 0..3 {
        log.append(&[model.random_record(&mut random, 6)], &[])
            .unwrap();
        ends.push(usize::try_from(fs::metadata(path.join(file)).unwrap().len()).unwrap());
    }
    let scene = Crashed::of("three changes", &path, &model);
    let bytes = &scene.files[file];
    let data = directory();
    for length in (0..=bytes.len()).step_by(8) {
        let log = match scene.judge(&data, file, Some(&bytes[..length])) {
            Outcome::Refused => panic!("{length} bytes are refused"),
            Outcome::Earlier(log) | Outcome::Exact(log) => log,
        };
        let whole = ends.iter().filter(|&&end| end <= length).count();
        assert_eq!(
            log.seq(),
            Seq(u64::try_from(whole).unwrap()),
            "{length} bytes"
        );
    }
}

/// What is lost need not be a change.
#[test]
fn a_snapshot_that_is_lost_takes_no_change_with_it_and_that_is_said() {
    let data = directory();
    let mut random = Random::new(6);
    let (mut log, path) = create(&data, KEEP);
    let mut model = Model::new();
    log.append(&[model.random_record(&mut random, 6)], &[])
        .unwrap();
    let file = "scene.sqlite-wal";
    let end = usize::try_from(fs::metadata(path.join(file)).unwrap().len()).unwrap();
    write_snapshot(&mut log, &model, &mut random);
    let scene = Crashed::of("a snapshot", &path, &model);
    drop(log);
    let data = directory();
    let path = scene.changed(&data, file, Some(&scene.files[file][..end]));
    let (_, cubes, notices) = reopen(&path, KEEP).unwrap();
    assert_eq!(&cubes, model.cubes());
    assert_eq!(notices.len(), 1, "{notices:?}");
    assert!(
        notices[0].contains("is lost, but no change with it"),
        "{notices:?}"
    );
}

/// Blocks that never reached the disk, or were lost on it.
#[test]
fn zeroed_blocks_never_give_a_wrong_state() {
    for scene in crashed_scenes() {
        for (file, bytes) in &scene.files {
            let zeroed = (0..bytes.len()).step_by(1024).flat_map(|at| {
                [512, 4096].map(|size| {
                    let mut zeroed = bytes.clone();
                    let end = zeroed.len().min(at + size);
                    zeroed[at..end].fill(0);
                    Some(zeroed)
                })
            });
            judge_all(&scene, file, zeroed);
        }
    }
}

#[test]
fn the_write_ahead_file_is_refused_in_the_middle_and_cut_at_the_end() {
    let scene = &crashed_scenes()[0];
    let file = "scene.sqlite-wal";
    let data = directory();
    let bytes = &scene.files[file];
    let judge_flip = |at: usize| {
        let mut flipped = bytes.clone();
        flipped[at] ^= 0x10;
        scene.judge(&data, file, Some(&flipped))
    };
    for (what, at) in [
        ("the header", 17),
        ("a page of the first change", 32 + 2000),
        ("a salt of it", 32 + 9),
    ] {
        assert!(matches!(judge_flip(at), Outcome::Refused), "{what}");
    }
    let last_page = judge_flip(bytes.len() - 2000);
    assert!(matches!(last_page, Outcome::Earlier(_)));
    drop(last_page);
    // What came after the last answer may be torn: nothing that was answered for is missing.
    let torn = [&bytes[..], &bytes[32..5000]].concat();
    let path = scene.changed(&data, file, Some(&torn));
    let (log, cubes, notices) = reopen(&path, KEEP).unwrap();
    assert_eq!(
        (log.seq(), &cubes),
        (Seq(scene.model.seq()), scene.model.cubes())
    );
    assert_eq!(notices.len(), 1, "nothing is said to be lost: {notices:?}");
    assert!(notices[0].contains("(2 frames, 4968 bytes)"), "{notices:?}");
    assert!(notices[0].contains("nothing that is known"), "{notices:?}");
    drop(log);
    let path = scene.changed(&data, "acknowledged", None);
    let (_, cubes, notices) = reopen(&path, KEEP).unwrap();
    assert_eq!(&cubes, scene.model.cubes());
    assert!(notices[0].contains("cannot be told"), "{notices:?}");
}

#[test]
fn verification_finds_what_replay_does_not_read() {
    let data = directory();
    let (mut log, path) = create(&data, KEEP);
    let mut random = Random::new(1);
    let mut model = Model::new();
    let records: Vec<_> = (0..9)
        .map(|_| model.random_record(&mut random, 3))
        .collect();
    let keys = [model.key(&mut random)];
    log.append(&records, &keys).unwrap();
    write_snapshot(&mut log, &model, &mut random);
    // Settings, head, snapshot, key, chunk, and two rows a change.
    let mut told = vec![];
    let verified = log.verify(&mut |thousandths| told.push(thousandths));
    assert_eq!(verified.unwrap(), 5 + 2 * 9);
    // Evenly, over the rows and the chunk; all of it only at the end.
    let mut even: Vec<u32> = (0..19).map(|row| row * 1000 / 19).collect();
    even.extend([999, 1000]);
    assert_eq!(told, even);
    drop(log);
    let connection = rusqlite::Connection::open(path.join("scene.sqlite")).unwrap();
    connection
        .execute("UPDATE changes SET at_ms = at_ms + 1 WHERE seq = 4", [])
        .unwrap();
    drop(connection);
    let (mut log, cubes, _) = reopen(&path, KEEP).unwrap();
    assert_eq!(&cubes, model.cubes());
    let is_4 = |error: &LogError| matches!(error, LogError::Damaged { seq: Seq(4), .. });
    assert!(is_4(&log.verify(&mut |_| {}).unwrap_err()));
    let history = log.history().unwrap();
    assert!(is_4(&history.at(Seq(4)).unwrap_err()));
    assert!(is_4(&history.rows(Seq(0), Seq(9), 9).unwrap_err()));
    assert!(history.at(Seq(5)).unwrap().is_some());
    drop((history, log));
    let connection = rusqlite::Connection::open(path.join("scene.sqlite")).unwrap();
    connection
        .execute("DELETE FROM changes WHERE seq = 4", [])
        .unwrap();
    drop(connection);
    let (mut log, ..) = reopen(&path, KEEP).unwrap();
    assert!(is_4(&log.verify(&mut |_| {}).unwrap_err()));
    assert!(is_4(&log.history().unwrap().at(Seq(4)).unwrap_err()));
}
