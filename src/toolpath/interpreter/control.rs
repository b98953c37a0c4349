//! O-words: branches, loops and subprograms by their labels.

use super::super::expression::Reader;
use super::super::flow::{self, Control, Keyword, Label};
use super::super::parameters::ARGUMENTS;
use super::super::text::Text;
use super::{Callee, Interpreter, InvalidLine, Loop, LoopKind, Position, Scope, Source};

impl Interpreter {
    /// A line with an O-word, which stands at `offset`.
    pub(super) fn control(&mut self, at: Position, offset: usize) -> Result<(), InvalidLine> {
        let bytes = self.sources[at.source].text.line(at.line).to_vec();
        let mut reader = Reader::new(&bytes);
        reader.at = offset;
        let (mut label, mut keyword) =
            flow::read(&mut reader).map_err(|wrong| self.unreadable(at, wrong))?;
        if label == Label::Computed {
            let number = self.value(&mut reader, at)?.round();
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "floats saturate; no label is that large"
            )]
            let number = number as u64;
            label = Label::Number(number);
            keyword = flow::keyword(&mut reader).map_err(|wrong| self.unreadable(at, wrong))?;
            if keyword != Keyword::Call {
                let what = "only a call may have a computed number";
                return Err(self.fault(at, offset, what));
            }
        }
        self.at.line += 1;
        match keyword {
            Keyword::Header => return self.header(at),
            Keyword::Sub => self.jump_behind(at, &label, &[Keyword::EndSub])?,
            Keyword::Call => return self.call(at, &label, &mut reader),
            // A return may have any label, such as that of the branch it stands in.
            Keyword::Return => return self.return_from_sub(at, None, &mut reader),
            Keyword::EndSub => return self.return_from_sub(at, Some(&label), &mut reader),
            Keyword::If => {
                if self.bracket(&mut reader, at)? == 0.0 {
                    self.next_branch(at, &label)?;
                }
            }
            // A branch was run: the others are not.
            Keyword::ElseIf | Keyword::Else => self.jump_behind(at, &label, &[Keyword::EndIf])?,
            Keyword::EndIf => {}
            Keyword::While => self.while_(at, &label, &mut reader)?,
            Keyword::EndWhile => {
                let open = self.innermost(at, &label, "endwhile")?;
                self.at.line = open.line;
            }
            Keyword::Do => self.frame().loops.push(Loop {
                label,
                line: at.line,
                kind: LoopKind::Do,
            }),
            Keyword::Repeat => self.repeat(at, label, &mut reader)?,
            Keyword::EndRepeat => self.end_repeat(at, &label)?,
            Keyword::Break => {
                let open = self.loop_of(at, &label, "break")?;
                self.frame().loops.pop();
                self.at.line = self.line_of_end(at, &open)? + 1;
            }
            Keyword::Continue => {
                let open = self.loop_of(at, &label, "continue")?;
                self.at.line = match open.kind {
                    LoopKind::While => open.line,
                    _ => self.line_of_end(at, &open)?,
                };
            }
        }
        self.rest(&mut reader, at)
    }

    fn repeat(
        &mut self,
        at: Position,
        label: Label,
        reader: &mut Reader<'_>,
    ) -> Result<(), InvalidLine> {
        let rounds = self.bracket(reader, at)?.round();
        if rounds < 1.0 {
            return self.jump_behind(at, &label, &[Keyword::EndRepeat]);
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "floats saturate, and so many rounds never end"
        )]
        let kind = LoopKind::Repeat(rounds as u64);
        self.frame().loops.push(Loop {
            label,
            line: at.line,
            kind,
        });
        Ok(())
    }

    fn end_repeat(&mut self, at: Position, label: &Label) -> Result<(), InvalidLine> {
        let open = self.innermost(at, label, "endrepeat")?;
        let loops = &mut self.frame().loops;
        match (open.kind, loops.last_mut()) {
            (LoopKind::Repeat(left @ 2..), Some(last)) => {
                last.kind = LoopKind::Repeat(left - 1);
                self.at.line = open.line + 1;
            }
            _ => {
                loops.pop();
            }
        }
        Ok(())
    }

    /// The line where a loop ends.
    fn line_of_end(&self, at: Position, open: &Loop) -> Result<usize, InvalidLine> {
        let end = match open.kind {
            LoopKind::While => Keyword::EndWhile,
            LoopKind::Do => Keyword::While,
            LoopKind::Repeat(_) => Keyword::EndRepeat,
        };
        let line = open.line;
        let begin = Position { line, ..at };
        Ok(self.next_control(begin, &open.label, &[end])?.line)
    }

    /// Nothing but a comment may follow.
    fn rest(&self, reader: &mut Reader<'_>, at: Position) -> Result<(), InvalidLine> {
        while reader.peek() == b'(' {
            reader
                .comment()
                .map_err(|wrong| self.unreadable(at, wrong))?;
        }
        match reader.peek() {
            // A bracket is the condition of a branch that is not looked at.
            0 | b';' | b'[' => Ok(()),
            _ => Err(self.fault(at, reader.at, "nothing may follow an o-word but its values")),
        }
    }

    fn value(&self, reader: &mut Reader<'_>, at: Position) -> Result<f64, InvalidLine> {
        let scope = self.scope(at);
        let value = reader.value(&scope);
        value
            .map(|(value, _)| value)
            .map_err(|wrong| self.unreadable(at, wrong))
    }

    fn bracket(&self, reader: &mut Reader<'_>, at: Position) -> Result<f64, InvalidLine> {
        let value = reader.bracket(&self.scope(at));
        value.map_err(|wrong| self.unreadable(at, wrong))
    }

    fn scope(&self, at: Position) -> Scope<'_> {
        Scope {
            parameters: &self.parameters,
            machine: &self.machine,
            call_level: self.frames.len() - 1,
            line: at.line,
            vacant: self.dialect.is_fanuc_like(),
        }
    }

    /// The number of a program: the first begins it, another ends what came before.
    fn header(&mut self, at: Position) -> Result<(), InvalidLine> {
        let first = self.sources[at.source]
            .controls
            .iter()
            .find(|control| control.keyword == Keyword::Header);
        if first.is_some_and(|first| first.line == at.line) && self.idle <= at.line as u64 + 1 {
            return Ok(());
        }
        let what = "another program begins here before the one before has ended (M30, M2 or M99)";
        Err(self.fault(at, 0, what))
    }

    /// The next O-word with a label and one of the keywords, after a line.
    fn next_control(
        &self,
        at: Position,
        label: &Label,
        keywords: &[Keyword],
    ) -> Result<&Control, InvalidLine> {
        let controls = &self.sources[at.source].controls;
        let from = controls.partition_point(|control| control.line <= at.line);
        controls[from..]
            .iter()
            .find(|control| control.label == *label && keywords.contains(&control.keyword))
            .ok_or_else(|| {
                let what = format!(
                    "{label} is not closed: {:?} is missing",
                    keywords[keywords.len() - 1]
                );
                self.fault(at, 0, what.to_lowercase())
            })
    }

    fn jump_behind(
        &mut self,
        at: Position,
        label: &Label,
        keywords: &[Keyword],
    ) -> Result<(), InvalidLine> {
        self.at.line = self.next_control(at, label, keywords)?.line + 1;
        Ok(())
    }

    /// Goes on at the branch whose condition holds, or behind the last.
    fn next_branch(&mut self, at: Position, label: &Label) -> Result<(), InvalidLine> {
        let mut from = at;
        loop {
            let branches = [Keyword::ElseIf, Keyword::Else, Keyword::EndIf];
            let next = self.next_control(from, label, &branches)?;
            let (line, keyword) = (next.line, next.keyword);
            from.line = line;
            self.at.line = line + 1;
            if keyword != Keyword::ElseIf {
                return Ok(());
            }
            let bytes = self.sources[from.source].text.line(line).to_vec();
            let mut reader = Reader::new(&bytes);
            flow::begins(&mut reader);
            flow::read(&mut reader).map_err(|wrong| self.unreadable(from, wrong))?;
            if self.bracket(&mut reader, from)? != 0.0 {
                return Ok(());
            }
        }
    }

    /// Begins or goes on with a while loop, or ends a do loop.
    fn while_(
        &mut self,
        at: Position,
        label: &Label,
        reader: &mut Reader<'_>,
    ) -> Result<(), InvalidLine> {
        let holds = self.bracket(reader, at)? != 0.0;
        let open = self
            .frame()
            .loops
            .last()
            .filter(|open| open.label == *label)
            .cloned();
        match open {
            Some(Loop {
                kind: LoopKind::Do,
                line,
                ..
            }) => {
                if holds {
                    self.at.line = line + 1;
                } else {
                    self.frame().loops.pop();
                }
            }
            Some(Loop {
                kind: LoopKind::While,
                line,
                ..
            }) if line == at.line => {
                if !holds {
                    self.frame().loops.pop();
                    self.jump_behind(at, label, &[Keyword::EndWhile])?;
                }
            }
            _ if holds => self.frame().loops.push(Loop {
                label: label.clone(),
                line: at.line,
                kind: LoopKind::While,
            }),
            _ => self.jump_behind(at, label, &[Keyword::EndWhile])?,
        }
        Ok(())
    }

    /// The innermost loop, which must have the label.
    fn innermost(&mut self, at: Position, label: &Label, word: &str) -> Result<Loop, InvalidLine> {
        let open = self
            .frame()
            .loops
            .last()
            .filter(|open| open.label == *label)
            .cloned();
        open.ok_or_else(|| self.fault(at, 0, format!("{label} {word} closes no open loop")))
    }

    /// The open loop with the label; those in it are given up.
    fn loop_of(&mut self, at: Position, label: &Label, word: &str) -> Result<Loop, InvalidLine> {
        let loops = &mut self.frame().loops;
        let Some(place) = loops.iter().rposition(|open| open.label == *label) else {
            return Err(self.fault(at, 0, format!("{label} {word} stands in no such loop")));
        };
        loops.truncate(place + 1);
        Ok(loops[place].clone())
    }

    fn call(
        &mut self,
        at: Position,
        label: &Label,
        reader: &mut Reader<'_>,
    ) -> Result<(), InvalidLine> {
        let mut arguments = Vec::new();
        while reader.peek() == b'[' {
            arguments.push(self.bracket(reader, at)?);
        }
        if arguments.len() > ARGUMENTS {
            return Err(self.fault(at, reader.at, "a call has at most 30 values"));
        }
        self.rest(reader, at)?;
        let start = self.find_sub(at, label)?;
        let kept = self.parameters.enter(&arguments);
        let callee = Callee::Sub {
            label: label.clone(),
            kept: Box::new(kept),
        };
        self.enter(at, callee, start)
    }

    /// Where a subprogram begins: in this file, in those read so far, or in a file of its name.
    fn find_sub(&mut self, at: Position, label: &Label) -> Result<Position, InvalidLine> {
        let order = std::iter::once(at.source).chain(0..self.sources.len());
        for source in order {
            if let Some(line) = self.sources[source].sub(label) {
                return Ok(Position {
                    source,
                    line: line + 1,
                });
            }
        }
        let name = match label {
            Label::Number(number) => number.to_string(),
            Label::Name(name) => name.clone(),
            Label::Computed => unreachable!("it is worked out before"),
        };
        let is_plain = !name.contains(['/', '\\']) && !name.starts_with('.');
        let file = self.options.directory.as_ref().filter(|_| is_plain);
        let Some(path) = file.map(|directory| directory.join(format!("{name}.ngc"))) else {
            return Err(self.fault(at, 0, format!("there is no {label} sub in this file")));
        };
        let bytes = std::fs::read(&path).map_err(|error| {
            let what = format!(
                "there is no {label} sub in this file, and {}: {error}",
                path.display()
            );
            self.fault(at, 0, what)
        })?;
        let text = Text::new(bytes)
            .map_err(|wrong| self.fault(at, 0, format!("{}: {}", path.display(), wrong.what)))?;
        self.sources
            .push(Source::new(Some(format!("{name}.ngc")), text));
        let source = self.sources.len() - 1;
        match self.sources[source].sub(label) {
            Some(line) => Ok(Position {
                source,
                line: line + 1,
            }),
            None => Err(self.fault(at, 0, format!("{} has no {label} sub", path.display()))),
        }
    }

    /// Ends a call; an endsub must have its label.
    fn return_from_sub(
        &mut self,
        at: Position,
        label: Option<&Label>,
        reader: &mut Reader<'_>,
    ) -> Result<(), InvalidLine> {
        let value = match reader.peek() {
            b'[' => Some(self.bracket(reader, at)?),
            _ => None,
        };
        self.rest(reader, at)?;
        match &self.frame().callee {
            Callee::Sub { label: open, .. } if label.is_none_or(|label| label == open) => {}
            _ => return Err(self.fault(at, 0, "a return from no open call")),
        }
        self.leave();
        let returned = f64::from(u8::from(value.is_some()));
        self.parameters
            .set_named("_value".into(), value.unwrap_or(0.0));
        self.parameters
            .set_named("_value_returned".into(), returned);
        Ok(())
    }
}
