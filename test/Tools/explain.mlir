// RUN: tai-opt %s --tai-explain --tai-eliminate-locals --tai-flatten-branches --cse -o /dev/null 2>&1 | FileCheck %s
// RUN: tai-opt %s --tai-explain --tai-autodiff -o /dev/null 2>&1 | FileCheck %s --check-prefix=GRAD
// RUN: tai-opt %s --tai-explain --cse -o %t 2>/dev/null
// RUN: tai-opt %s --cse -o %t.without && cmp %t %t.without
// RUN: not tai-opt %s --tai-explain --tai-test-failure=invalid=true -o /dev/null 2>&1 | FileCheck %s --check-prefix=FAILS
// RUN: not tai-opt %s.missing --tai-explain --cse 2>&1 | FileCheck %s --check-prefix=FILE

// Each kernel has its passes, in their order, with their remarks and the ops
// that changed.
// CHECK-LABEL: {{^}}@clamp
//  CHECK-NEXT:   tai-eliminate-locals: {{.*}}tai.alloca 1 -> 0{{.*}}tai.local_load 1 -> 0, tai.local_store 1 -> 0
//  CHECK-NEXT:   tai-flatten-branches: flattened, {{.*}}both arms run, and a select takes the result
//  CHECK-NEXT:   tai-flatten-branches: arith.select 0 -> 1, {{.*}}scf.if 1 -> 0
//  CHECK-NEXT:   cse: arith.constant 2 -> 1
// CHECK-LABEL: {{^}}@plain
//  CHECK-NEXT:   no pass changed it

// GRAD-LABEL: {{^}}@clamp_grad
//       GRAD:   tai-make-adjoint: made, of {{[0-9]+}} ops

// FAILS: tai-test-failure: fails

// FILE: {{[Nn]o such file}}

tai.tree @t : !tai.root<dense<[i: 8], {x: f32, "x.grad": f32, y: f32, "y.grad": f32}>>
tai.field @x = @t["x"] : f32, rank 1, adjoint @x.grad
tai.field @x.grad = @t["x.grad"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1, adjoint @y.grad
tai.field @y.grad = @t["y.grad"] : f32, rank 1

tai.kernel @clamp() {
  %c0 = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %local = tai.alloca : !tai.local<f32>
    %negative = arith.cmpf olt, %x, %c0 : f32
    scf.if %negative {
      tai.local_store %x, %local : f32
    }
    %kept = tai.local_load %local : f32
    tai.store %kept, @y[%i] : f32
  }
  tai.return
}

tai.kernel @plain(%a: f32) {
  tai.parallel_for (%i) in @y {
    tai.store %a, @y[%i] : f32
  }
  tai.return
}
