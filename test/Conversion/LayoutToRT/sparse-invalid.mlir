// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-lower-struct-for --tai-lower-layout

tai.tree @t : !tai.root<dynamic<[i: 4], chunk 1, {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1

tai.kernel @append(%v: f32) {
  // expected-error @+1 {{'tai.append' op reaches layout lowering; expects a cell and a store, as tai-scalarize makes them}}
  %0 = tai.append %v, @x[] : f32
  tai.return
}
