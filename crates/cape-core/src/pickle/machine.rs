//! Stack machine of the pickle protocol.

use std::collections::HashMap;

use super::{
    class::{Class, ClassKind},
    node::{Bytes, Item, Node, Object},
    text::{raw_unicode, string_literal},
};

/// Newest supported protocol.
const NEWEST: u8 = 5;
/// Largest stack size. Python's pickler uses about a thousand entries; tuples may be longer.
const MAX_STACK: usize = 1 << 20;
/// Longest class name or number in the text protocol, bytes.
const MAX_LINE: usize = 1 << 10;
/// Largest number of pickles within each other.
const MAX_NESTED: usize = 4;
/// Memo entries allowed beyond one for each object.
const SPARE_MEMOS: usize = 1 << 10;

type Result<T, E = String> = std::result::Result<T, E>;

/// Objects built by a pickle program.
pub(super) struct ObjectGraph {
    pub(super) nodes: Vec<Node>,
    pub(super) classes: Vec<Class>,
    pub(super) root: Item,
}

/// Runs the pickle in `source`.
pub(super) fn run(source: &[u8]) -> Result<ObjectGraph> {
    let mut machine = Machine {
        source,
        at: 0,
        // A container takes at least two bytes: one to create it, one to store it.
        max_nodes: source.len() / 2 + (1 << 16),
        stack: Vec::new(),
        marks: Vec::new(),
        memo: HashMap::new(),
        nodes: Vec::new(),
        classes: Vec::new(),
        depth: 0,
    };
    loop {
        let start = machine.at;
        match machine.step() {
            Ok(None) => {}
            Ok(Some(root)) => {
                let Machine { nodes, classes, .. } = machine;
                return Ok(ObjectGraph { nodes, classes, root });
            }
            Err(message) => return Err(format!("{message} (at byte {start})")),
        }
    }
}

pub(super) struct Machine<'a> {
    source: &'a [u8],
    pub(super) at: usize,
    max_nodes: usize,
    stack: Vec<Item>,
    /// Stack heights at the open MARKs.
    marks: Vec<usize>,
    memo: HashMap<u64, Item>,
    nodes: Vec<Node>,
    classes: Vec<Class>,
    /// Pickles that this one is within.
    depth: usize,
}

impl<'a> Machine<'a> {
    /// Executes one instruction; returns the root object at STOP.
    fn step(&mut self) -> Result<Option<Item>> {
        let [code] = self.bytes()?;
        match code {
            b'.' => return self.pop().map(Some),
            0x80 => {
                let [protocol] = self.bytes()?;
                if protocol > NEWEST {
                    return Err(format!("protocol {protocol}, expected at most {NEWEST}"));
                }
            }
            // FRAME: a length that is not needed.
            0x95 => drop(self.bytes::<8>()?),

            b'(' => self.marks.push(self.stack.len()),
            b'0' => match self.marks.last() {
                Some(&mark) if mark == self.stack.len() => drop(self.marks.pop()),
                _ => drop(self.pop()?),
            },
            b'1' => drop(self.pop_mark()?),
            b'2' => {
                let top = self.top()?;
                self.push(top)?;
            }

            b'N' => self.push(Item::None)?,
            0x88 => self.push(Item::Bool(true))?,
            0x89 => self.push(Item::Bool(false))?,
            b'I' | b'L' => {
                let line = self.line()?;
                let value = decimal(line)?;
                self.push(value)?;
            }
            b'J' => {
                let value = i32::from_le_bytes(self.bytes()?);
                self.push(Item::Int(value.into()))?;
            }
            b'K' => {
                let [value] = self.bytes()?;
                self.push(Item::Int(value.into()))?;
            }
            b'M' => {
                let value = u16::from_le_bytes(self.bytes()?);
                self.push(Item::Int(value.into()))?;
            }
            0x8a => {
                let [length] = self.bytes()?;
                self.long(length.into())?;
            }
            0x8b => {
                let length = self.length4()?;
                self.long(length)?;
            }
            b'F' => {
                let line = self.line()?;
                let text = std::str::from_utf8(line).unwrap_or_default();
                let value = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
                self.push(Item::Float(value))?;
            }
            b'G' => {
                let value = f64::from_be_bytes(self.bytes()?);
                self.push(Item::Float(value))?;
            }

            b'S' => {
                let line = self.whole_line()?;
                self.put(Node::Bytes(Bytes::Owned(string_literal(line)?)))?;
            }
            b'V' => {
                // Carriage returns are escaped in strings: one at the end is a line end of Windows.
                let line = self.whole_line()?;
                let line = line.strip_suffix(b"\r").unwrap_or(line);
                self.put(Node::Text(Bytes::Owned(raw_unicode(line)?)))?;
            }
            b'U' | b'C' => self.byte_string(1)?,
            b'T' => {
                // The length is signed.
                if self.source.get(self.at + 3).is_some_and(|&high| high >= 0x80) {
                    return Err("string of negative length".into());
                }
                self.byte_string(4)?;
            }
            b'B' => self.byte_string(4)?,
            0x8e | 0x96 => self.byte_string(8)?,
            0x8c => self.text(1)?,
            b'X' => self.text(4)?,
            0x8d => self.text(8)?,

            b']' => self.put(Node::List(Vec::new()))?,
            b'}' => self.put(Node::Dict(Vec::new()))?,
            b')' => self.put(Node::Tuple(Box::default()))?,
            0x8f => self.put(Node::Set(Vec::new()))?,
            b'l' => {
                let items = self.pop_mark()?;
                self.put(Node::List(items))?;
            }
            b't' => {
                let items = self.pop_mark()?;
                self.put(Node::Tuple(items.into()))?;
            }
            0x85..=0x87 => {
                let count = usize::from(code - 0x84);
                let items = self.pop_many(count)?;
                self.put(Node::Tuple(items.into()))?;
            }
            b'd' => {
                let entries = pairs(&self.pop_mark()?)?;
                self.put(Node::Dict(entries))?;
            }
            0x91 => {
                let items = self.pop_mark()?;
                self.put(Node::Set(items))?;
            }
            b'a' => {
                let item = self.pop()?;
                self.append(&[item])?;
            }
            b'e' | 0x90 => {
                let items = self.pop_mark()?;
                self.append(&items)?;
            }
            b's' => {
                let entry = self.pop_many(2)?;
                self.set(&entry)?;
            }
            b'u' => {
                let entries = self.pop_mark()?;
                self.set(&entries)?;
            }

            b'p' | b'q' | b'r' | 0x94 => {
                let key = match code {
                    0x94 => self.memo.len() as u64,
                    _ => self.memo_key(code)?,
                };
                let top = self.top()?;
                // Only containers, strings and objects are memoised.
                if self.memo.len() > self.nodes.len() + SPARE_MEMOS {
                    return Err("more memo entries than objects".into());
                }
                self.memo.insert(key, top);
            }
            b'g' | b'h' | b'j' => {
                // GET, BINGET and LONG_BINGET encode the key as PUT, BINPUT and LONG_BINPUT.
                let key = self.memo_key(match code {
                    b'g' => b'p',
                    b'h' => b'q',
                    _ => b'r',
                })?;
                let item = self.memo.get(&key).copied();
                self.push(item.ok_or_else(|| format!("memo {key} was never written"))?)?;
            }

            b'c' => {
                let (module, name) = (self.line()?, self.line()?);
                self.class(module, name)?;
            }
            0x93 => {
                let name = self.pop()?;
                let module = self.pop()?;
                let (module, name) = (self.name(module)?, self.name(name)?);
                self.class(&module, &name)?;
            }
            b'R' | 0x81 => {
                let arguments = self.pop()?;
                let callable = self.pop()?;
                self.object(callable, arguments)?;
            }
            0x92 => {
                let keywords = self.pop()?;
                if !matches!(self.node(keywords), Some(Node::Dict(entries)) if entries.is_empty()) {
                    return Err("object created with keyword arguments".into());
                }
                let arguments = self.pop()?;
                let class = self.pop()?;
                self.object(class, arguments)?;
            }
            b'i' => {
                let (module, name) = (self.line()?, self.line()?);
                let arguments = self.pop_mark()?;
                self.class(module, name)?;
                let class = self.pop()?;
                self.put(Node::Tuple(arguments.into()))?;
                let arguments = self.pop()?;
                self.object(class, arguments)?;
            }
            b'o' => {
                let items = self.pop_mark()?;
                let [class, arguments @ ..] = &*items else {
                    return Err("object without a class".into());
                };
                self.put(Node::Tuple(arguments.into()))?;
                let arguments = self.pop()?;
                self.object(*class, arguments)?;
            }
            b'b' => {
                let state = self.pop()?;
                let top = self.top()?;
                let class = match self.node_mut(top) {
                    Some(Node::Object(object)) => {
                        object.state = state;
                        object.class
                    }
                    _ => return Err("state for a value that is not an object".into()),
                };
                if self.classes[class as usize].kind == ClassKind::JoblibArray {
                    self.joblib_data(top, state)?;
                }
            }

            b'P' | b'Q' => return Err("refers to an object outside the file".into()),
            0x82..=0x84 => return Err("refers to a class by a registered number".into()),
            0x97 | 0x98 => return Err("keeps its arrays in buffers outside the file".into()),
            _ => return Err(format!("unknown instruction 0x{code:02x}")),
        }
        Ok(None)
    }

    /// Runs a pickle within this one, at the present place, and returns its root object.
    pub(super) fn nested(&mut self) -> Result<Item> {
        if self.depth >= MAX_NESTED {
            return Err(format!("more than {MAX_NESTED} pickles within each other"));
        }
        self.depth += 1;
        let stack = std::mem::take(&mut self.stack);
        let marks = std::mem::take(&mut self.marks);
        let memo = std::mem::take(&mut self.memo);
        let root = loop {
            if let Some(root) = self.step()? {
                break root;
            }
        };
        (self.stack, self.marks, self.memo) = (stack, marks, memo);
        self.depth -= 1;
        Ok(root)
    }

    pub(super) fn take(&mut self, length: usize) -> Result<&'a [u8]> {
        let taken = self.source.get(self.at..).and_then(|rest| rest.get(..length));
        let taken = taken.ok_or_else(|| {
            let left = self.source.len().saturating_sub(self.at);
            format!(
                "unexpected end: {length} bytes expected, {left} left: the file is incomplete, copy or \
                 download it again"
            )
        })?;
        self.at += length;
        Ok(taken)
    }

    pub(super) fn bytes<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        Ok(bytes)
    }

    fn whole_line(&mut self) -> Result<&'a [u8]> {
        let rest = &self.source[self.at..];
        let end = rest
            .iter()
            .position(|&byte| byte == b'\n')
            .ok_or("ends inside a line: the file is incomplete")?;
        self.at += end + 1;
        Ok(&rest[..end])
    }

    /// Line with a number or a name.
    fn line(&mut self) -> Result<&'a [u8]> {
        let line = self.whole_line()?.trim_ascii();
        if line.len() > MAX_LINE {
            return Err(format!(
                "number or name of {} bytes, expected at most {MAX_LINE}",
                line.len()
            ));
        }
        Ok(line)
    }

    fn length4(&mut self) -> Result<usize> {
        Ok(u32::from_le_bytes(self.bytes()?) as usize)
    }

    /// Range of a byte string that follows its length of `width` bytes.
    fn span(&mut self, width: u8) -> Result<Bytes> {
        let length = match width {
            1 => usize::from(self.bytes::<1>()?[0]),
            4 => self.length4()?,
            _ => usize::try_from(u64::from_le_bytes(self.bytes()?)).unwrap_or(usize::MAX),
        };
        let start = self.at;
        self.take(length)?;
        Ok(Bytes::Source(start..self.at))
    }

    fn byte_string(&mut self, width: u8) -> Result<()> {
        let bytes = self.span(width)?;
        self.put(Node::Bytes(bytes))
    }

    fn text(&mut self, width: u8) -> Result<()> {
        let bytes = self.span(width)?;
        self.put(Node::Text(bytes))
    }

    /// Little-endian two's complement integer.
    fn long(&mut self, length: usize) -> Result<()> {
        let bytes = self.take(length)?;
        let sign = match bytes.last() {
            Some(&high) if high >= 0x80 => 0xff,
            _ => 0,
        };
        let (low, high) = bytes.split_at(length.min(8));
        let mut value = [sign; 8];
        value[..low.len()].copy_from_slice(low);
        let value = i64::from_le_bytes(value);
        let fits = high.iter().all(|&byte| byte == sign) && (value < 0) == (sign != 0);
        self.push(if fits { Item::Int(value) } else { Item::Long })
    }

    fn push(&mut self, item: Item) -> Result<()> {
        if self.stack.len() >= MAX_STACK {
            return Err(format!("more than {MAX_STACK} values on the stack"));
        }
        self.stack.push(item);
        Ok(())
    }

    fn put(&mut self, node: Node) -> Result<()> {
        let item = self.add(node)?;
        self.push(item)
    }

    /// Adds an object without putting it on the stack.
    pub(super) fn add(&mut self, node: Node) -> Result<Item> {
        let number = self.nodes.len();
        if number >= self.max_nodes {
            return Err("more objects than a file of this size can define".into());
        }
        self.nodes.push(node);
        Ok(Item::Node(number as u32))
    }

    fn top(&self) -> Result<Item> {
        self.stack.last().copied().ok_or_else(|| "the stack is empty".to_owned())
    }

    /// Pops the top value; values below the last MARK are not accessible.
    fn pop(&mut self) -> Result<Item> {
        let floor = self.marks.last().copied().unwrap_or(0);
        match self.stack.pop() {
            Some(item) if self.stack.len() >= floor => Ok(item),
            _ => Err("the stack is empty".into()),
        }
    }

    fn pop_many(&mut self, count: usize) -> Result<Vec<Item>> {
        let floor = self.marks.last().copied().unwrap_or(0);
        match self.stack.len().checked_sub(count) {
            Some(rest) if rest >= floor => Ok(self.stack.split_off(rest)),
            _ => Err("the stack is empty".into()),
        }
    }

    fn pop_mark(&mut self) -> Result<Vec<Item>> {
        let mark = self.marks.pop().ok_or("no mark on the stack")?;
        if mark > self.stack.len() {
            return Err("the stack is empty".into());
        }
        Ok(self.stack.split_off(mark))
    }

    pub(super) fn node(&self, item: Item) -> Option<&Node> {
        match item {
            Item::Node(number) => self.nodes.get(number as usize),
            _ => None,
        }
    }

    pub(super) fn node_mut(&mut self, item: Item) -> Option<&mut Node> {
        match item {
            Item::Node(number) => self.nodes.get_mut(number as usize),
            _ => None,
        }
    }

    fn append(&mut self, items: &[Item]) -> Result<()> {
        let top = self.top()?;
        match self.node_mut(top) {
            Some(Node::List(list) | Node::Set(list)) => list.extend(items),
            Some(Node::Object(object)) => object.list.extend(items),
            _ => return Err("elements for a value that is not a list".into()),
        }
        Ok(())
    }

    fn set(&mut self, entries: &[Item]) -> Result<()> {
        let entries = pairs(entries)?;
        let top = self.top()?;
        match self.node_mut(top) {
            Some(Node::Dict(dict)) => dict.extend(entries),
            Some(Node::Object(object)) => object.entries.extend(entries),
            _ => return Err("entries for a value that is not a dictionary".into()),
        }
        Ok(())
    }

    fn memo_key(&mut self, code: u8) -> Result<u64> {
        Ok(match code {
            b'p' => match decimal(self.line()?)? {
                Item::Int(key) => {
                    u64::try_from(key).map_err(|_| format!("negative memo key {key}"))?
                }
                _ => return Err("memo key that is not an integer".into()),
            },
            b'q' => self.bytes::<1>()?[0].into(),
            _ => u32::from_le_bytes(self.bytes()?).into(),
        })
    }

    pub(super) fn name(&self, item: Item) -> Result<Vec<u8>> {
        let Some(Node::Text(bytes) | Node::Bytes(bytes)) = self.node(item) else {
            return Err("class name that is not a string".into());
        };
        let bytes = match bytes {
            Bytes::Source(range) => &self.source[range.clone()],
            Bytes::Owned(bytes) => bytes,
        };
        if bytes.len() > MAX_LINE {
            return Err(format!(
                "class name of {} bytes, expected at most {MAX_LINE}",
                bytes.len()
            ));
        }
        Ok(bytes.to_vec())
    }

    fn class(&mut self, module: &[u8], name: &[u8]) -> Result<()> {
        let (module, name) = (String::from_utf8_lossy(module), String::from_utf8_lossy(name));
        let class = Class::find(&module, &name).ok_or_else(|| {
            let remedy = if module.split('.').next() == Some("torch") {
                "; convert PyTorch's tensors by `.cpu().numpy()` before saving"
            } else {
                ""
            };
            format!(
                "`{}.{}` is not allowed: only data of NumPy, SciPy, chumpy, scikit-learn, joblib and \
                 Python itself is read{remedy}",
                module.escape_debug(),
                name.escape_debug()
            )
        })?;
        let number = match self.classes.iter().position(|known| *known == class) {
            Some(number) => number,
            None if self.classes.len() >= 256 => return Err("more than 256 classes".into()),
            None => {
                self.classes.push(class);
                self.classes.len() - 1
            }
        };
        self.put(Node::Class(number as u32))
    }

    fn class_of(&self, item: Item) -> Result<u32> {
        match self.node(item) {
            Some(Node::Class(number)) => Ok(*number),
            _ => Err("call of a value that is not a class".into()),
        }
    }

    fn object(&mut self, callable: Item, arguments: Item) -> Result<()> {
        let mut class = self.class_of(callable)?;
        if self.classes[class as usize].kind == ClassKind::Empty {
            class = match self.node(arguments) {
                Some(Node::Tuple(arguments)) if !arguments.is_empty() => {
                    self.class_of(arguments[0])?
                }
                _ => return Err("instance without a class".into()),
            };
        }
        self.put(Node::Object(Box::new(Object {
            class,
            arguments,
            state: Item::None,
            list: Vec::new(),
            entries: Vec::new(),
        })))
    }
}

fn pairs(items: &[Item]) -> Result<Vec<(Item, Item)>> {
    let (pairs, rest) = items.as_chunks::<2>();
    if !rest.is_empty() {
        return Err("a key without a value".into());
    }
    Ok(pairs.iter().map(|&[key, value]| (key, value)).collect())
}

/// Integer or boolean of the text protocol: `12`, `12L`, `01` for true, `00` for false.
fn decimal(line: &[u8]) -> Result<Item> {
    match line {
        b"00" => return Ok(Item::Bool(false)),
        b"01" => return Ok(Item::Bool(true)),
        _ => {}
    }
    let text = std::str::from_utf8(line).unwrap_or_default();
    let digits = text.strip_suffix('L').unwrap_or(text);
    match digits.parse() {
        Ok(value) => Ok(Item::Int(value)),
        Err(_)
            if !digits.is_empty()
                && digits.trim_start_matches('-').bytes().all(|b| b.is_ascii_digit()) =>
        {
            Ok(Item::Long)
        }
        Err(_) => Err(format!("`{}` is not an integer", text.escape_debug())),
    }
}
