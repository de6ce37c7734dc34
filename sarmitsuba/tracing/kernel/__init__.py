"""Ray tracing of coherent paths: geometry, fields, tubes, scatterers and the kernel."""
