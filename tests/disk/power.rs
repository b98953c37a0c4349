//! The power fails after every single call of a workload that writes.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use union3d::geometry::Totals;
use union3d::service::{AnyAudit, Offline};

use super::Random;
use super::disk::{Disk, Event, temporary};
use super::image::{Image, Reached};
use super::workload::{Acknowledged, Client, Story, World, data};

/// Lets a client work and gives the record of what its disk saw.
pub(crate) fn record(
    disk: &Disk,
    mut client: Client<'_>,
    work: impl AsyncFnOnce(&mut Client<'_>),
) -> (Vec<Event>, Story) {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(work(&mut client));
    (disk.events(), client.story)
}

/// Seq and totals of every scene.
type Found = BTreeMap<String, (u64, Totals)>;

/// What a recovery finds, as kept and as recounted.
fn recover(root: &Path) -> Result<Found, String> {
    if !data(root).join("scenes").exists() {
        return Ok(Found::new());
    }
    let offline = Offline::open(&data(root)).map_err(|error| error.to_string())?;
    let mut found = Found::new();
    for name in offline.scenes() {
        let audit = offline.audit(name, &mut |_| ());
        let audit = audit.map_err(|error| format!("{}: {error}", name.as_str()))?;
        if let Some(lost) = audit.notices.iter().find(|notice| notice.contains("lost")) {
            return Err(lost.clone());
        }
        let AnyAudit::Cubes(audit) = audit.audit else {
            return Err(format!("{}: of another kind", name.as_str()));
        };
        if audit.kept != audit.recounted {
            return Err(format!("{}: differs from a recount", name.as_str()));
        }
        found.insert(name.as_str().to_owned(), (audit.seq.0, audit.kept));
    }
    Ok(found)
}

/// The story of a client up to the moment when the power fails.
#[derive(Clone, Copy)]
struct Moment<'a> {
    story: &'a Story,
    mark: usize,
}

impl Moment<'_> {
    /// What of a scene was acknowledged, and what is on its way.
    fn ends(&self, name: &str) -> [Option<Acknowledged>; 2] {
        let worlds = &self.story.worlds;
        let next = (self.mark + 1).min(worlds.len() - 1);
        [self.mark, next].map(|mark| worlds[mark].get(name).copied())
    }

    /// What was found as what had been acknowledged or was on its way; an error when it is neither.
    fn recognise(&self, found: &Found) -> Result<World, String> {
        let worlds = self.story.worlds[self.mark..].iter().take(2);
        let names = worlds.flat_map(BTreeMap::keys).chain(found.keys());
        let mut recognised = World::new();
        for name in names {
            let ends = self.ends(name);
            let life = match (found.get(name), ends) {
                (None, ends) if ends.contains(&None) => continue,
                (Some((seq, _)), [Some(from), Some(to)])
                    if from.life == to.life && (from.seq..=to.seq).contains(seq) =>
                {
                    Some(from.life)
                }
                (Some((seq, _)), [Some(only), None] | [None, Some(only)]) if *seq == only.seq => {
                    Some(only.life)
                }
                _ => None,
            };
            let scene = life.zip(found.get(name)).filter(|(life, (seq, totals))| {
                self.story.totals.get(&(name.clone(), *life, *seq)) == Some(totals)
            });
            let Some((life, &(seq, _))) = scene else {
                let found = found.get(name).map(|(seq, _)| seq);
                let [known, next] = ends;
                return Err(format!(
                    "{name}: found seq {found:?}, known is {known:?}, on its way {next:?}"
                ));
            };
            recognised.insert(name.clone(), Acknowledged { life, seq });
        }
        Ok(recognised)
    }
}

/// Shows every moment of a record that `wanted` picks: after which event, and what the disk is then.
fn moments(
    events: &[Event],
    story: &Story,
    random: &mut Random,
    mut wanted: impl FnMut(&Event) -> bool,
    mut visit: impl FnMut(&Image, Moment<'_>, &mut Random, &dyn std::fmt::Display),
) {
    let mut image = Image::new();
    let mut mark = 0;
    for (index, event) in events.iter().enumerate() {
        image.apply(event, random);
        if let Event::Mark(next) = event {
            mark = *next;
        }
        if wanted(event) {
            let moment = Moment { story, mark };
            visit(
                &image,
                moment,
                random,
                &format_args!("call {index}, {event:?}"),
            );
        }
    }
}

/// The failures of power cuts at those moments that `wanted` picks, in `ways` different ways each.
pub(crate) fn cut_all(
    events: &[Event],
    story: &Story,
    random: &mut Random,
    ways: usize,
    wanted: impl FnMut(&Event) -> bool,
) -> Vec<String> {
    let mut failures = Vec::new();
    moments(
        events,
        story,
        random,
        wanted,
        |image, moment, random, when| {
            let some = std::iter::repeat_with(|| Reached::some(random));
            let reached = [Reached::None, Reached::All].into_iter().chain(some);
            for reached in reached.take(ways) {
                let root = temporary();
                image.write_to(root.path(), &reached);
                let found = recover(root.path()).and_then(|found| moment.recognise(&found));
                if let Err(what) = found {
                    failures.push(format!("{when}, {reached:?} reached: {what}"));
                }
            }
        },
    );
    failures
}

#[track_caller]
pub(crate) fn assert_none(failures: &[String]) {
    let first = &failures[..failures.len().min(20)];
    assert!(
        failures.is_empty(),
        "{}:\n{}",
        failures.len(),
        first.join("\n")
    );
}

#[test]
fn nothing_acknowledged_is_lost_by_a_power_cut_after_any_call() {
    let seed = 1;
    let disk = Disk::new();
    let client = Client::new(&disk, seed);
    let (events, story) = record(&disk, client, async |client| client.everything().await);
    println!("{} calls", events.len());
    let failures = cut_all(&events, &story, &mut Random::new(seed), 4, |_| true);
    assert_none(&failures);
}

/// Every so many moments the power fails or only the process dies, a service goes on with what is left, and the power fails again at
/// any moment of that.
fn cut_twice(step: usize, seed: u64) {
    let disk = Disk::new();
    let client = Client::new(&disk, seed);
    let (events, story) = record(&disk, client, async |client| client.everything().await);
    let random = &mut Random::new(seed);
    let first = usize::try_from(random.below(step as u64)).unwrap();
    let mut index = 0;
    let every = |_: &Event| {
        index += 1;
        index % step == first
    };
    let mut failures = Vec::new();
    moments(
        &events,
        &story,
        random,
        every,
        |image, moment, random, when| {
            let reached = match random.below(2) {
                0 => Reached::All,
                _ => Reached::some(random),
            };
            let disk = Disk::new();
            image.write_to(disk.path(), &reached);
            let copy = temporary();
            image.write_to(copy.path(), &reached);
            let world = recover(copy.path()).and_then(|found| moment.recognise(&found));
            let world = match world {
                Ok(world) => world,
                Err(what) => return failures.push(format!("{when}, {reached:?} reached: {what}")),
            };
            disk.make_durable();
            let client = Client::go_on(&disk, random.next(), world, story.totals.clone());
            let (events, story) = record(&disk, client, async |client| client.changes().await);
            let mut begun = false;
            let later = cut_all(&events, &story, random, 3, |event| {
                begun |= matches!(event, Event::Mark(_));
                begun
            });
            let told = |what| format!("{when}, {reached:?} reached; then {what}");
            failures.extend(later.into_iter().map(told));
        },
    );
    assert_none(&failures);
}

#[test]
fn nothing_acknowledged_is_lost_by_a_second_power_cut() {
    cut_twice(150, 3);
}

#[test]
#[ignore = "minutes: twice at any moment"]
fn nothing_acknowledged_is_lost_by_any_two_power_cuts() {
    cut_twice(1, 4);
}

/// All files of a directory but SQLite's shared index, which is written through memory and made anew after a crash.
fn files(directory: &Path, to: &mut BTreeMap<PathBuf, Vec<u8>>) {
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files(&path, to);
        } else if path
            .extension()
            .is_none_or(|extension| extension != "sqlite-shm")
        {
            to.insert(path.clone(), fs::read(path).unwrap());
        }
    }
}

/// No call is missed: what is made of the record is what is there.
#[test]
fn the_record_holds_all_that_reaches_the_files() {
    let disk = Disk::new();
    let client = Client::new(&disk, 2);
    let (events, _) = record(&disk, client, async |client| client.everything().await);
    let mut random = Random::new(2);
    let mut image = Image::new();
    for event in &events {
        image.apply(event, &mut random);
    }
    let copy = temporary();
    image.write_to(copy.path(), &Reached::All);
    let [there, recorded] = [disk.path(), copy.path()].map(|root| {
        let mut found = BTreeMap::new();
        files(root, &mut found);
        let found = found.into_iter();
        let found = found.map(|(path, bytes)| (path.strip_prefix(root).unwrap().to_owned(), bytes));
        found.collect::<BTreeMap<_, _>>()
    });
    assert!(there.len() > 4, "{:?}", there.keys());
    assert!(
        there.keys().eq(recorded.keys()),
        "{:?} {:?}",
        there.keys(),
        recorded.keys()
    );
    for (path, bytes) in there {
        assert!(bytes == recorded[&path], "{} differs", path.display());
    }
}
