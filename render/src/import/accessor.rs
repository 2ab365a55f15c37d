//! Accessors: typed, strided, possibly sparse arrays in buffers.
//!
//! [`Layout::check`] proves, without the bytes, that every element lies inside its buffer view; reading then needs the
//! bytes and cannot fail but for values (numbers that are not finite).

use super::buffer::{Buffers, ByteRange, View};
use super::document::Document;
use super::json::{Item, Result};

/// How one number is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn read(item: &Item) -> Result<Self> {
        Ok(match item.unsigned()? {
            5120 => Component::I8,
            5121 => Component::U8,
            5122 => Component::I16,
            5123 => Component::U16,
            5125 => Component::U32,
            5126 => Component::F32,
            other => {
                return Err(item.error(format!("{other} is not a component type; glTF has 5120 to 5123, 5125, 5126")));
            }
        })
    }
    fn bytes(self) -> usize {
        match self {
            Component::I8 | Component::U8 => 1,
            Component::I16 | Component::U16 => 2,
            Component::U32 | Component::F32 => 4,
        }
    }
    fn is_unsigned(self) -> bool {
        matches!(self, Component::U8 | Component::U16 | Component::U32)
    }
    /// The number at the start of `bytes`; 0 where they are too few. Normalised integers by glTF §3.6.2.2.
    #[inline]
    fn float(self, bytes: &[u8], normalized: bool) -> f32 {
        let unit = |value: f32, max: f32| if normalized { (value / max).max(-1.0) } else { value };
        match self {
            Component::I8 => unit(f32::from(bytes.first().copied().unwrap_or(0) as i8), 127.0),
            Component::U8 => unit(f32::from(bytes.first().copied().unwrap_or(0)), 255.0),
            Component::I16 => unit(f32::from(i16::from_le_bytes(prefix(bytes))), 32_767.0),
            Component::U16 => unit(f32::from(u16::from_le_bytes(prefix(bytes))), 65_535.0),
            Component::U32 => u32::from_le_bytes(prefix(bytes)) as f32,
            Component::F32 => f32::from_le_bytes(prefix(bytes)),
        }
    }
    #[inline]
    fn index(self, bytes: &[u8]) -> u32 {
        match self {
            Component::I8 | Component::U8 => u32::from(bytes.first().copied().unwrap_or(0)),
            Component::I16 | Component::U16 => u32::from(u16::from_le_bytes(prefix(bytes))),
            Component::U32 | Component::F32 => u32::from_le_bytes(prefix(bytes)),
        }
    }
}

#[inline]
fn prefix<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.first_chunk::<N>().copied().unwrap_or([0; N])
}

/// Numbers an element of `type` has, and the bytes they take (matrix columns are padded to 4 bytes).
fn shape(item: &Item, component: Component) -> Result<(usize, usize)> {
    let (columns, rows) = match item.text()? {
        "SCALAR" => (1, 1),
        "VEC2" => (1, 2),
        "VEC3" => (1, 3),
        "VEC4" => (1, 4),
        "MAT2" => (2, 2),
        "MAT3" => (3, 3),
        "MAT4" => (4, 4),
        _ => return Err(item.error("must be SCALAR, VEC2, VEC3, VEC4, MAT2, MAT3 or MAT4")),
    };
    let column = rows * component.bytes();
    let bytes = if columns == 1 { column } else { columns * column.next_multiple_of(4) };
    Ok((columns * rows, bytes))
}

/// Equally spaced elements in a buffer view.
#[derive(Clone, Copy)]
struct Strided {
    view: View,
    offset: usize,
    stride: usize,
    element: usize,
    /// Bytes from the first element to the end of the last.
    span: usize,
}

impl Strided {
    /// Checks that `count` elements of `element` bytes, from `byteOffset` of `item` on, lie inside the view.
    fn check(item: &Item, view: View, view_index: usize, count: usize, element: usize, align: usize) -> Result<Self> {
        let offset = item.opt("byteOffset", Item::size)?.unwrap_or(0);
        let stride = view.stride.unwrap_or(element);
        if stride < element {
            return Err(item.error(format!(
                "its elements take {element} bytes, more than the byteStride {stride} of bufferViews[{view_index}]"
            )));
        }
        let aligned = [offset, view.offset().saturating_add(offset), stride].iter().all(|n| n.is_multiple_of(align));
        if !aligned {
            return Err(item.error(format!(
                "misaligned: byteOffset {offset} in bufferViews[{view_index}] at byte {} is not a multiple of {align}",
                view.offset()
            )));
        }
        let end = count.saturating_sub(1).checked_mul(stride).and_then(|n| n.checked_add(element)?.checked_add(offset));
        if count > 0 && end.is_none_or(|end| end > view.len()) {
            return Err(item.error(format!(
                "out of range: {count} elements from byteOffset {offset} on do not fit the {} bytes of bufferViews[{view_index}]",
                view.len()
            )));
        }
        let span = end.map_or(0, |end| end - offset);
        Ok(Strided { view, offset, stride, element, span })
    }
    /// Which bytes the elements take.
    fn range(&self) -> ByteRange {
        self.view.part(self.offset, self.span)
    }
    /// An element, where `bytes` are those of [`Strided::range`].
    #[inline]
    fn element<'b>(&self, bytes: &'b [u8], index: usize) -> &'b [u8] {
        let start = index * self.stride;
        bytes.get(start..start + self.element).unwrap_or(&[])
    }
}

/// Elements that differ from the base array.
#[derive(Clone)]
struct Sparse {
    count: usize,
    indices: Strided,
    component: Component,
    values: Strided,
    place: String,
}

/// A checked accessor, without its bytes.
#[derive(Clone)]
pub(super) struct Layout {
    /// Elements.
    pub(super) count: usize,
    /// Numbers in an element.
    pub(super) lanes: usize,
    component: Component,
    normalized: bool,
    base: Option<Strided>,
    sparse: Option<Sparse>,
    place: String,
}

impl Layout {
    /// Checks all accessors.
    ///
    /// # Errors
    /// Names the first one that is damaged.
    pub(super) fn check_all(doc: &Document, views: &[View]) -> Result<Vec<Layout>> {
        (0..doc.count("accessors")).map(|i| Layout::check(doc, &doc.item("accessors", i)?, views)).collect()
    }

    fn check(doc: &Document, item: &Item, views: &[View]) -> Result<Self> {
        let component = Component::read(&item.require("componentType")?)?;
        let (lanes, element) = shape(&item.require("type")?, component)?;
        let count_item = item.require("count")?;
        let count = count_item.size()?;
        if count == 0 {
            return Err(count_item.error("must be at least 1"));
        }
        if u32::try_from(count).is_err() {
            return Err(count_item.limit("the number of elements", count as u64, u32::MAX.into(), "split the mesh"));
        }
        let normalized = item.opt("normalized", Item::flag)?.unwrap_or(false);
        let base = match doc.reference(item, "bufferView", "bufferViews")? {
            Some(index) => {
                let view = views.get(index).copied().ok_or_else(|| item.error("its buffer view does not exist"))?;
                Some(Strided::check(item, view, index, count, element, component.bytes())?)
            }
            None => None,
        };
        let sparse =
            item.get("sparse")?.map(|s| check_sparse(doc, &s, views, count, element, component)).transpose()?;
        Ok(Layout { count, lanes, component, normalized, base, sparse, place: item.place() })
    }

    /// True when the elements are unsigned integers, as indices must be.
    pub(super) fn is_index(&self) -> bool {
        self.lanes == 1 && self.component.is_unsigned() && !self.normalized
    }
    /// The bytes that reading it takes.
    pub(super) fn ranges(&self) -> impl Iterator<Item = ByteRange> + '_ {
        let sparse = self.sparse.iter().flat_map(|s| [s.indices.range(), s.values.range()]);
        self.base.iter().map(Strided::range).chain(sparse)
    }
    /// Where the accessor stands in the file.
    pub(super) fn place(&self) -> &str {
        &self.place
    }

    /// The bytes needed to read elements.
    ///
    /// # Errors
    /// When sparse indices are not ascending, or reach beyond the accessor.
    pub(super) fn open<'b>(&'b self, buffers: &'b Buffers) -> Result<Reader<'b>> {
        let sparse = self.sparse.as_ref().map(|s| s.open(buffers, self.count)).transpose()?;
        let base = self.base.as_ref().map(|b| (b, buffers.bytes(b.range())));
        Ok(Reader { layout: self, base, sparse })
    }
}

fn check_sparse(
    doc: &Document,
    item: &Item,
    views: &[View],
    total: usize,
    element: usize,
    component: Component,
) -> Result<Sparse> {
    let count_item = item.require("count")?;
    let count = count_item.size()?;
    if count == 0 || count > total {
        return Err(count_item.error(format!("must be from 1 to the accessor's count {total}, found {count}")));
    }
    let part = |part: &Item, element: usize, align: usize| -> Result<Strided> {
        let index = doc.index(&part.require("bufferView")?, "bufferViews")?;
        let view = views.get(index).copied().ok_or_else(|| part.error("its buffer view does not exist"))?;
        Strided::check(part, view, index, count, element, align)
    };
    let indices_item = item.require("indices")?;
    let type_item = indices_item.require("componentType")?;
    let index_type = Component::read(&type_item)?;
    if !index_type.is_unsigned() {
        return Err(type_item.error("sparse indices must be unsigned integers (5121, 5123 or 5125)"));
    }
    let indices = part(&indices_item, index_type.bytes(), index_type.bytes())?;
    let values = part(&item.require("values")?, element, component.bytes())?;
    Ok(Sparse { count, indices, component: index_type, values, place: indices_item.place() })
}

impl Sparse {
    fn open<'b>(&'b self, buffers: &'b Buffers, total: usize) -> Result<OpenSparse<'b>> {
        let bytes = buffers.bytes(self.indices.range());
        let indices: Vec<u32> = (0..self.count).map(|i| self.component.index(self.indices.element(bytes, i))).collect();
        let ascending = indices.windows(2).all(|pair| pair[0] < pair[1]);
        if !ascending || indices.last().is_some_and(|&last| last as usize >= total) {
            return Err(crate::error::SceneError::invalid(
                &self.place,
                format!("sparse indices must ascend and stay below the accessor's count {total}"),
            ));
        }
        Ok(OpenSparse { indices, values: &self.values, bytes: buffers.bytes(self.values.range()) })
    }
}

struct OpenSparse<'b> {
    indices: Vec<u32>,
    values: &'b Strided,
    bytes: &'b [u8],
}

/// An accessor with its bytes.
pub(super) struct Reader<'b> {
    layout: &'b Layout,
    base: Option<(&'b Strided, &'b [u8])>,
    sparse: Option<OpenSparse<'b>>,
}

impl Reader<'_> {
    /// Bytes of element `index`; empty stands for zeros.
    #[inline]
    fn element(&self, index: usize) -> &[u8] {
        if let Some(sparse) = &self.sparse
            && let Ok(at) = sparse.indices.binary_search(&(index as u32))
        {
            return sparse.values.element(sparse.bytes, at);
        }
        self.base.map_or(&[], |(strided, bytes)| strided.element(bytes, index))
    }
    /// Element `index` as an unsigned integer.
    #[inline]
    pub(super) fn index(&self, index: usize) -> u32 {
        self.layout.component.index(self.element(index))
    }
    /// The elements `which`, as vectors of `N` numbers (further numbers of an element are left out, missing ones are
    /// `fill`).
    ///
    /// # Errors
    /// Names the first element that is not finite.
    pub(super) fn vectors<const N: usize>(
        &self,
        which: impl Iterator<Item = usize>,
        fill: f32,
    ) -> Result<Vec<[f32; N]>> {
        let layout = self.layout;
        let width = layout.component.bytes();
        let mut out = Vec::with_capacity(which.size_hint().0);
        for index in which {
            let bytes = self.element(index);
            let mut vector = [fill; N];
            for (lane, slot) in vector.iter_mut().enumerate().take(layout.lanes) {
                *slot = layout.component.float(bytes.get(lane * width..).unwrap_or(&[]), layout.normalized);
            }
            if !vector.iter().all(|v| v.is_finite()) {
                return Err(crate::error::SceneError::invalid(
                    &layout.place,
                    format!("element {index} is not finite: {vector:?}; repair or re-export the mesh"),
                ));
            }
            out.push(vector);
        }
        Ok(out)
    }
}
