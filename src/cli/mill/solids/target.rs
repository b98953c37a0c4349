//! Where the solids of a program go: into an engine in this process, or into a scene of a server.

use std::time::Duration;

use serde_json::Value;
use union3d::engine::solids::{self, SolidId};
use union3d::wire::proto::Change;
use union3d::wire::solids::{Scale, SolidMeasures, SolidProperties, solid_properties};

use super::super::super::client::Client;
use super::super::super::credentials::Credentials;
use super::super::grpc::{self, Done, GrpcStream};
use super::super::http::{self, HttpStream, UNREADABLE};
use super::super::line::Material as State;
use super::super::tally::{self, Kind, ToolCut};
use super::Failure;
use super::material::{Blank, Material};
use super::scene::{Defined, Wanted, decimal};
use super::shop::{Carried, Cut, Stroke, line_of};

/// Most solids of a change: a message of some megabytes.
pub(super) const CHANGE_SOLIDS_MAX: usize = 65_536;

/// So many passes wait in this process until they are cut together, on all processors.
const PASSES_AT_ONCE: usize = 1024;

/// Where the solids go.
pub(super) enum Target {
    Here {
        material: Box<Material>,
        waiting: Vec<Stroke>,
        passes: usize,
    },
    Http {
        stream: Box<HttpStream<Told>>,
        defined: Defined,
        watch: Box<Watch>,
    },
    Grpc {
        stream: Box<GrpcStream<Told>>,
        server: String,
        scene: String,
        defined: Defined,
        watch: Box<Watch>,
    },
}

/// What is known of a stroke before it is done.
pub(super) struct Told {
    line: u64,
    kind: Kind,
    duration: Option<Duration>,
    tool: u32,
    bodies: u64,
    /// What its shank and holder go through, if nobody else changes the scene.
    hit: i128,
    /// Its area of contact, under the same condition; none where it is not known.
    contact: Option<i128>,
    /// Whether they come near the stock.
    is_asked: bool,
}

/// What is measured at the end.
pub(super) struct Measured {
    /// What is removed.
    pub(super) removed: SolidProperties,
    /// What is left of the stock.
    pub(super) remaining: Option<SolidProperties>,
}

/// Follows, beside a server, what the program alone removes: what shanks and holders go through, and the contact of moves, is asked in between
/// changes that are in flight.
pub(super) struct Watch {
    blank: Blank,
    /// Whether the contact of moves is wanted: then all is cut here, too.
    says_contact: bool,
    /// What has been cut before anything had to be asked.
    so_far: Vec<Cut>,
    material: Option<Material>,
    /// The newest change of the scene that is known, as long as all after the first were this program's.
    seq: Option<u64>,
}

impl Target {
    /// In this process, with the contact of moves if that is wanted.
    pub(super) fn here((blank, says_contact): (&Blank, bool)) -> Self {
        Self::Here {
            material: Box::new(Material::new(blank).with_contact(says_contact)),
            waiting: Vec::new(),
            passes: 0,
        }
    }

    /// Into a scene, over HTTP.
    pub(super) async fn http(
        server: &str,
        credentials: &Credentials,
        wanted: &Wanted,
        (blank, says_contact): (&Blank, bool),
    ) -> Result<Self, Failure> {
        let mut client = Client::of(server, credentials, &wanted.name)?;
        let found = match wanted.find_http(&mut client).await? {
            Some(found) => wanted.check_empty(found)?,
            None => wanted.create_http(&client).await?,
        };
        Ok(Self::Http {
            stream: Box::new(HttpStream::new(client)),
            defined: Defined::default(),
            watch: Box::new(Watch::new(blank.clone(), says_contact, found.seq)),
        })
    }

    /// Into a scene, over gRPC.
    pub(super) async fn grpc(
        server: &str,
        credentials: &Credentials,
        wanted: &Wanted,
        (blank, says_contact): (&Blank, bool),
    ) -> Result<Self, Failure> {
        let mut client = grpc::connect(server, credentials).await?;
        let found = wanted.open_grpc(&mut client, server).await?;
        let found = wanted.check_empty(found)?;
        Ok(Self::Grpc {
            stream: Box::new(GrpcStream::open(server, client, &wanted.name).await?),
            server: server.to_owned(),
            scene: wanted.name.clone(),
            defined: Defined::default(),
            watch: Box::new(Watch::new(blank.clone(), says_contact, found.seq)),
        })
    }

    /// Sends a stroke on its way; answers what is done by now, in the order of the program.
    pub(super) async fn send(&mut self, stroke: Stroke) -> Result<Vec<tally::Cut>, Failure> {
        match self {
            Self::Here {
                material,
                waiting,
                passes,
            } => {
                *passes += stroke.passes.len();
                waiting.push(stroke);
                if *passes < PASSES_AT_ONCE {
                    return Ok(vec![]);
                }
                *passes = 0;
                Ok(cut_together(material, &std::mem::take(waiting))?)
            }
            Self::Http {
                stream,
                defined,
                watch,
            } => {
                for cut in stroke.cuts() {
                    let client = stream.client();
                    defined.define_http(client, &cut.carried.swept).await?;
                }
                let told = watch.told(&stroke)?;
                watch.http(stream.send(told, change(&stroke)?).await?)
            }
            Self::Grpc {
                stream,
                server,
                scene,
                defined,
                watch,
            } => {
                for cut in stroke.cuts() {
                    let client = stream.client();
                    defined
                        .define_grpc(client, server, scene, &cut.carried.swept)
                        .await?;
                }
                let told = watch.told(&stroke)?;
                let done = stream.send(told, change(&stroke)?).await?;
                Ok(done.into_iter().map(|done| watch.done(done)).collect())
            }
        }
    }

    /// Waits for all that is on its way, and reads what is measured then.
    pub(super) async fn finish(self, scale: Scale) -> Result<(Vec<tally::Cut>, Measured), Failure> {
        Ok(match self {
            Self::Here {
                mut material,
                waiting,
                ..
            } => {
                let cuts = cut_together(&mut material, &waiting)?;
                let (totals, error_max) = material.totals();
                let of = |totals: &solids::Totals| {
                    solid_properties(None, None, (totals, &error_max), scale, 1.0)
                };
                let remaining = totals
                    .remaining
                    .map(|measures| of(&solids::Totals { measures, ..totals }));
                let removed = of(&totals);
                (cuts, Measured { removed, remaining })
            }
            Self::Http {
                stream, mut watch, ..
            } => {
                let (done, answer) = stream.finish().await?;
                (watch.http(done)?, Measured::read(answer.get())?)
            }
            Self::Grpc {
                stream,
                server,
                mut watch,
                ..
            } => {
                let (done, answer) = stream.finish().await?;
                let cuts = done.into_iter().map(|done| watch.done(done)).collect();
                (
                    cuts,
                    Measured::of_message(&server, answer.solid_mass_properties)?,
                )
            }
        })
    }
}

impl Measured {
    fn new(removed: SolidProperties, remaining: Option<SolidMeasures>) -> Self {
        let remaining = remaining.map(|measures| SolidProperties {
            measures,
            ..removed.clone()
        });
        Self { removed, remaining }
    }

    /// From the API's mass properties.
    fn read(answer: &str) -> Result<Self, serde_json::Error> {
        #[derive(serde::Deserialize)]
        struct Remaining {
            remaining: Option<SolidMeasures>,
        }
        let Remaining { remaining } = serde_json::from_str(answer)?;
        Ok(Self::new(serde_json::from_str(answer)?, remaining))
    }

    /// From the same as a message.
    pub(super) fn of_message(
        server: &str,
        message: Option<union3d::wire::proto::SolidMassProperties>,
    ) -> Result<Self, grpc::Failure> {
        let remaining = message
            .as_ref()
            .and_then(|message| message.remaining.clone());
        let remaining = remaining.map(|remaining| grpc::read(server, Some(remaining)));
        Ok(Self::new(
            grpc::read(server, message)?,
            remaining.transpose()?,
        ))
    }
}

impl Watch {
    fn new(blank: Blank, says_contact: bool, seq: u64) -> Self {
        Self {
            blank,
            says_contact,
            so_far: Vec::new(),
            material: None,
            seq: Some(seq),
        }
    }

    /// What is known of a stroke before the server has done it.
    fn told(&mut self, stroke: &Stroke) -> Result<Told, String> {
        if self.says_contact {
            let new = || Material::new(&self.blank).with_contact(true);
            let material = self.material.get_or_insert_with(new);
            let mut done = mill(material, std::slice::from_ref(stroke))?;
            let done = done.pop().expect("there is one for each stroke");
            return Ok(Told::of(stroke, done.hit, done.contact()));
        }
        let mut hit = 0;
        for pass in &stroke.passes {
            if let Some(cut) = &pass.flutes {
                match &mut self.material {
                    Some(material) => {
                        material.remove(vec![(cut.id, cut.carried.body(stroke.line)?)]);
                    }
                    None => self.so_far.push(cut.clone()),
                }
            }
            if let Some(blunt) = &pass.blunt {
                let blank = &self.blank;
                let material = self.material.get_or_insert_with(|| Material::new(blank));
                let so_far = self.so_far.drain(..);
                let so_far = so_far.map(|cut| Ok((cut.id, cut.carried.body(line_of(cut.id))?)));
                material.remove(so_far.collect::<Result<_, String>>()?);
                hit += material.inside(blunt.body(stroke.line)?);
            }
        }
        Ok(Told::of(stroke, hit, None))
    }

    /// Notes that a change of the program is done; false when somebody else has changed the scene since the program began.
    fn note(&mut self, seq: u64) -> bool {
        self.seq = self.seq.filter(|before| before + 1 == seq).map(|_| seq);
        self.seq.is_some()
    }

    /// What was done over HTTP.
    fn http(&mut self, done: Vec<http::Done<Told>>) -> Result<Vec<tally::Cut>, Failure> {
        let cut = |done: http::Done<Told>| {
            let (seq, removed, after) = read(&done.answer).ok_or(UNREADABLE)?;
            Ok(done.what.cut(removed, after, self.note(seq)))
        };
        done.into_iter().map(cut).collect()
    }

    fn done(&mut self, done: Done<Told>) -> tally::Cut {
        let Done {
            what,
            outcome,
            removed,
            after,
        } = done;
        let is_alone = self.note(outcome.seq);
        what.cut(removed, after, is_alone)
    }
}

/// Cuts strokes in this process, in their order.
fn cut_together(material: &mut Material, strokes: &[Stroke]) -> Result<Vec<tally::Cut>, String> {
    let mut after = material.state();
    let done = mill(material, strokes)?;
    let says_contact = material.says_contact();
    let cuts = strokes.iter().zip(done).map(|(stroke, done)| {
        after.add(done.more);
        let contact = done.contact().filter(|_| says_contact);
        Told::of(stroke, done.hit, contact).cut(done.more.removed, after, true)
    });
    Ok(cuts.collect())
}

/// What each of some strokes does to the material, one after the other; what shanks and holders hit is asked in between.
fn mill(material: &mut Material, strokes: &[Stroke]) -> Result<Vec<Milled>, String> {
    let mut done = vec![Milled::default(); strokes.len()];
    let mut moves: Vec<(usize, Vec<(SolidId, solids::Body)>)> = Vec::new();
    let cut = |material: &mut Material, moves: &mut Vec<_>, done: &mut [Milled]| {
        let (owners, moves): (Vec<usize>, Vec<_>) = moves.drain(..).unzip();
        for (owner, (more, contact)) in owners.into_iter().zip(material.remove_moves(moves)) {
            done[owner].add(more, contact);
        }
    };
    for (index, stroke) in strokes.iter().enumerate() {
        for pass in &stroke.passes {
            if let Some(Cut { id, carried }) = &pass.flutes {
                if moves.last().is_none_or(|(owner, _)| *owner != index) {
                    moves.push((index, Vec::new()));
                }
                let (_, bodies) = moves.last_mut().expect("there is one now");
                bodies.push((*id, carried.body(stroke.line)?));
            }
            if let Some(blunt) = &pass.blunt {
                cut(material, &mut moves, &mut done);
                done[index].hit += material.inside(blunt.body(stroke.line)?);
            }
        }
    }
    cut(material, &mut moves, &mut done);
    Ok(done)
}

/// What a stroke did in this process.
#[derive(Clone, Default)]
struct Milled {
    more: State,
    hit: i128,
    /// The contact of those of its solids that were cut together and removed something.
    contacts: Vec<Option<i128>>,
}

impl Milled {
    fn add(&mut self, more: State, contact: Option<i128>) {
        self.more.add(more);
        if more.removed != 0 {
            self.contacts.push(contact);
        }
    }

    /// Its area of contact. When a question about a holder came between solids that removed something, it is not known.
    fn contact(&self) -> Option<i128> {
        match self.contacts[..] {
            [] => Some(0),
            [contact] => contact,
            _ => None,
        }
    }
}

impl Told {
    fn of(stroke: &Stroke, hit: i128, contact: Option<i128>) -> Self {
        Self {
            line: stroke.line,
            kind: stroke.kind,
            duration: stroke.duration,
            tool: stroke.tool,
            bodies: stroke.cuts().count() as u64,
            hit,
            contact,
            is_asked: stroke.passes.iter().any(|pass| pass.blunt.is_some()),
        }
    }

    /// What it did; `is_alone` when nobody else has changed the material.
    fn cut(&self, removed: i128, after: State, is_alone: bool) -> tally::Cut {
        tally::Cut {
            line: self.line,
            kind: self.kind,
            duration: self.duration,
            bodies: self.bodies,
            removed,
            total_removed: after.removed,
            area: after.area,
            tool: Some(ToolCut {
                number: self.tool,
                hit: (is_alone || !self.is_asked).then_some(self.hit),
                contact: self.contact.filter(|_| is_alone),
            }),
        }
    }
}

/// The change that a stroke is in a scene.
fn change(stroke: &Stroke) -> Result<Change, Failure> {
    let count = stroke.cuts().count();
    if count > CHANGE_SOLIDS_MAX {
        return Err(format!(
            "line {}: its {count} chords are more than a change of a scene takes, {CHANGE_SOLIDS_MAX}: take a greater --tolerance",
            stroke.line
        )
        .into());
    }
    Ok(Change {
        // A change has a move and a time also when it cuts nothing.
        r#move: Some(stroke.line),
        duration: stroke.duration.map(|duration| duration.as_secs_f64()),
        ..inserted(stroke.cuts().map(|cut| (cut.id, cut)))
    })
}

/// A change that inserts solids with these ids.
pub(super) fn inserted<'a>(cuts: impl Iterator<Item = (SolidId, &'a Cut)>) -> Change {
    let mut change = Change::default();
    for (id, cut) in cuts {
        let Carried { swept, ends } = &cut.carried;
        change.insert_sweep(id, &swept.name, *ends);
    }
    change
}

/// The seq of a change, what it removed and the state after it, from the API's answer to it; none when it is not that.
fn read(answer: &Value) -> Option<(u64, i128, State)> {
    let exact = &answer["mass_properties"]["exact"];
    let after = State {
        removed: decimal(&exact["volume"]["value"])?,
        area: decimal(&exact["area"]["value"])?,
    };
    let removed = decimal(&answer["volume_removed_exact"])?;
    Some((answer["seq"].as_u64()?, removed, after))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Once somebody else has changed the scene, what shanks and holders go through is not known any more, also when changes follow each
    /// other again; a stroke that asks for nothing is known to hit nothing.
    #[test]
    fn hits_are_known_as_long_as_nobody_else_changes_the_scene() {
        let blank = Blank::new(None, Scale::new(1000).unwrap()).unwrap();
        let mut watch = Watch::new(blank, false, 5);
        let told = |is_asked| Told {
            line: 1,
            kind: Kind::Feed,
            duration: None,
            tool: 1,
            bodies: 1,
            hit: 0,
            contact: Some(7),
            is_asked,
        };
        let after = State {
            removed: 0,
            area: 0,
        };
        for (seq, known) in [(6, true), (7, true), (9, false), (10, false)] {
            let is_alone = watch.note(seq);
            let tool = |told: Told| told.cut(0, after, is_alone).tool.unwrap();
            assert_eq!(tool(told(true)).hit, known.then_some(0), "{seq}");
            assert_eq!(tool(told(false)).hit, Some(0), "{seq}");
            assert_eq!(tool(told(false)).contact, known.then_some(7), "{seq}");
        }
    }
}
