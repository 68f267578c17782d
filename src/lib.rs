//! RenderFlow.
