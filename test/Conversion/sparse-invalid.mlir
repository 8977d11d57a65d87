// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-lower-struct-for --tai-lower-layout

// expected-note @+1 {{a layout of 'dense' levels alone can be lowered}}
tai.tree @t : !tai.root<pointer<[i: 4], dense<[i: 8], {x: f32}>>>
// expected-note @+1 {{field defined here}}
tai.field @x = @t["x"] : f32, rank 1

tai.kernel @visit() {
  // expected-error @+1 {{'tai.parallel_for' op reaches the field @x through a 'pointer' level, which cannot be lowered yet}}
  tai.parallel_for (%i) in @x {
  }
  tai.return
}

// -----

// expected-note @+1 {{a layout of 'dense' levels alone can be lowered}}
tai.tree @t : !tai.root<hash<[i: 4], {x: f32}>>
// expected-note @+1 {{field defined here}}
tai.field @x = @t["x"] : f32, rank 1

tai.kernel @read(%i: index) -> f32 {
  // expected-error @+1 {{'tai.load' op reaches the field @x through a 'hash' level, which cannot be lowered yet}}
  %0 = tai.load @x[%i] : f32
  tai.return %0 : f32
}

// -----

tai.tree @t : !tai.root<bitmasked<[i: 4], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1

tai.kernel @ask(%i: index) {
  // expected-error @+1 {{'tai.activate' op acts on the topology of a sparse level, which cannot be lowered yet}}
  tai.activate @x[%i] level 1
  tai.return
}
