"""Previews of a material: new cameras, lights and shapes, in Mitsuba's own path tracer."""
