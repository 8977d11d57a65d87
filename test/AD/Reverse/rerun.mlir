// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s

// If the reverse needs both the former and the new values of a field, the
// iteration is run forward again and records it.

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, plain: f32, v: vector<2xf32>, v_grad: vector<2xf32>}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @v_grad = @t["v_grad"] : vector<2xf32>, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @v = @t["v"] : vector<2xf32>, rank 1, adjoint @v_grad
tai.field @plain = @t["plain"] : f32, rank 1

// Outside of serial loops a recorded value is that of the rerun itself.
// CHECK-LABEL: tai.kernel @sequence_grad() attributes {reads_before = [@x], reexecutes} {
//       CHECK:   tai.parallel_for (%[[I:.+]]) in @x {
//   CHECK-NOT:     tai.stack
//       CHECK:     %[[A:.+]] = tai.load @x[%[[I]]]
//       CHECK:     %[[S:.+]] = math.sin %[[A]]
//       CHECK:     tai.store %[[S]], @x[%[[I]]]
//       CHECK:     %[[B:.+]] = tai.load @x[%[[I]]]
//       CHECK:     math.sin %[[B]]
//       CHECK:     tai.store %{{.+}}, @x[%[[I]]]
//       CHECK:     %[[G:.+]] = tai.load @x_grad[%[[I]]]
//       CHECK:     tai.store %{{.+}}, @x_grad[%[[I]]]
//       CHECK:     math.cos %[[B]]
//       CHECK:     tai.atomic add %{{.+}}, @x_grad[%[[I]]] exclusive
//       CHECK:     tai.load @x_grad[%[[I]]]
//       CHECK:     tai.store %{{.+}}, @x_grad[%[[I]]]
//       CHECK:     math.cos %[[A]]
//       CHECK:     tai.atomic add %{{.+}}, @x_grad[%[[I]]] exclusive
tai.kernel @sequence() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i] : f32
    %2 = tai.load @x[%i] : f32
    %3 = math.sin %2 : f32
    tai.store %3, @x[%i] : f32
  }
  tai.return
}

// In a serial loop it is pushed by the rerun and popped by the reverse.
// Unneeded operations are not run again.
// CHECK-LABEL: tai.kernel @repeated_grad() attributes {reads_before = [@x], reexecutes} {
//       CHECK:   tai.parallel_for (%[[I:.+]]) in @x {
//       CHECK:     %[[STACK:.+]] = tai.stack_create : !tai.stack<f32>
//       CHECK:     scf.for
//       CHECK:       %[[X:.+]] = tai.load @x[%[[I]]]
//       CHECK:       tai.stack_push %[[X]], %[[STACK]] : f32
//   CHECK-NOT:       @plain
//       CHECK:       tai.store %{{.+}}, @x[%[[I]]]
//       CHECK:     }
//       CHECK:     scf.for
//       CHECK:       %[[OLD:.+]] = tai.stack_pop %[[STACK]] : f32
//       CHECK:       tai.load @x_grad[%[[I]]]
//       CHECK:       tai.store %{{.+}}, @x_grad[%[[I]]]
//       CHECK:       math.cos %[[OLD]]
//       CHECK:       tai.atomic add %{{.+}}, @x_grad
//       CHECK:     }
//       CHECK:     tai.stack_destroy %[[STACK]]
tai.kernel @repeated() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) in @x {
    scf.for %k = %c0 to %c4 step %c1 {
      %0 = tai.load @x[%i] : f32
      %1 = math.sin %0 : f32
      tai.store %1, @x[%i] : f32
      %2 = math.exp %1 : f32
      tai.store %2, @plain[%i] : f32
    }
  }
  tai.return
}

// Vectors are kept by components; values of branches are popped in the branch.
// CHECK-LABEL: tai.kernel @branches_grad(
//       CHECK:     %[[S0:.+]] = tai.stack_create : !tai.stack<f32>
//       CHECK:     %[[S1:.+]] = tai.stack_create : !tai.stack<f32>
//       CHECK:     scf.for
//       CHECK:       scf.if
//       CHECK:         tai.load @v
//   CHECK-DAG:         tai.stack_push %{{.+}}, %[[S0]]
//   CHECK-DAG:         tai.stack_push %{{.+}}, %[[S1]]
//       CHECK:     scf.for
//       CHECK:       scf.if
//   CHECK-DAG:         tai.stack_pop %[[S0]]
//   CHECK-DAG:         tai.stack_pop %[[S1]]
//       CHECK:     tai.stack_destroy
//       CHECK:     tai.stack_destroy
tai.kernel @branches(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    scf.for %k = %c0 to %n step %c1 {
      %c = arith.cmpi slt, %k, %i : index
      scf.if %c {
        %0 = tai.load @v[%i] : vector<2xf32>
        %1 = math.sin %0 : vector<2xf32>
        tai.store %1, @v[%i] : vector<2xf32>
      }
    }
  }
  tai.return
}

// A recurrence that runs over and over: the loops are run again as a whole,
// with their carried values.
// CHECK-LABEL: tai.kernel @sweeps_grad(%{{.+}}: index) attributes {reads_before = [@x], reexecutes} {
//   CHECK-DAG:   %[[STACK:.+]] = tai.stack_create
//       CHECK:   scf.for
//       CHECK:     scf.for
//       CHECK:       tai.stack_push
//       CHECK:       tai.store %{{.+}}, @x
//       CHECK:   scf.for
//       CHECK:     scf.for
//       CHECK:       tai.stack_pop
tai.kernel @sweeps(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  scf.for %t = %c0 to %c3 step %c1 {
    scf.for %j = %c1 to %n step %c1 {
      %k = arith.subi %j, %c1 : index
      %0 = tai.load @x[%k] : f32
      %1 = tai.load @x[%j] : f32
      %2 = arith.mulf %0, %1 : f32
      tai.store %2, @x[%j] : f32
    }
  }
  tai.return
}

// How long a loop ran is counted when it is run again. The condition that ends
// it has pushed too: its value is popped, needed or not.
// CHECK-LABEL: tai.kernel @until_grad(
//       CHECK:     %[[STACK:.+]] = tai.stack_create
//       CHECK:     %[[LENGTH:.+]] = scf.while (%[[COUNT:.+]] = %{{.+}}) : (index) -> index {
//       CHECK:       %[[X:.+]] = tai.load @x
//       CHECK:       scf.condition
//       CHECK:     } do {
//       CHECK:       tai.store %{{.+}}, @x
//       CHECK:     scf.for %{{.+}} = %{{.+}} to %[[LENGTH]] step
//       CHECK:       tai.stack_pop
tai.kernel @until(%limit: f32) {
  tai.parallel_for (%i) in @x {
    scf.while : () -> () {
      %0 = tai.load @x[%i] : f32
      %more = arith.cmpf ogt, %0, %limit : f32
      scf.condition(%more)
    } do {
      %0 = tai.load @x[%i] : f32
      %1 = math.sin %0 : f32
      tai.store %1, @x[%i] : f32
      scf.yield
    }
  }
  tai.return
}

// Numbers are drawn again in the same order. No field is written: no tape need
// know.
// CHECK-LABEL: tai.kernel @random_in_loop_grad() {
//       CHECK:     %[[STACK:.+]] = tai.stack_create
//       CHECK:     scf.for
//       CHECK:       %[[U:.+]] = tai.random stream 3
//       CHECK:       tai.stack_push %[[U]], %[[STACK]]
//       CHECK:     scf.for
//       CHECK:       %[[V:.+]] = tai.stack_pop %[[STACK]]
//   CHECK-NOT:       tai.random
//       CHECK:       arith.mulf %{{.+}}, %[[V]]
//       CHECK:     tai.stack_destroy %[[STACK]]
tai.kernel @random_in_loop() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) in @x {
    scf.for %k = %c0 to %c4 step %c1 {
      %u = tai.random stream 3 : f32
      %0 = tai.load @x[%i] : f32
      %1 = arith.mulf %0, %u : f32
      tai.atomic add %1, @y[%k] : f32
    }
  }
  tai.return
}
