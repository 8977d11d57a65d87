// RUN: tai-run %s --no-cache
// RUN: tai-run %s --no-cache --deterministic --threads=1

// Gradients through branches, serial loops and while loops agree with central
// differences.

tai.tree @data : !tai.root<
    dense<[i: 12], {x: f64, x_grad: f64, y: f64, y_grad: f64, n: i32, next: i32,
                    p: vector<2xf64>, p_grad: vector<2xf64>,
                    q: vector<2xf64>, q_grad: vector<2xf64>}>,
    {a: f64, a_grad: f64, loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : f64, rank 1
tai.field @y_grad = @data["y_grad"] : f64, rank 1
tai.field @p_grad = @data["p_grad"] : vector<2xf64>, rank 1
tai.field @q_grad = @data["q_grad"] : vector<2xf64>, rank 1
tai.field @a_grad = @data["a_grad"] : f64, rank 0
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @x = @data["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @data["y"] : f64, rank 1, adjoint @y_grad
tai.field @p = @data["p"] : vector<2xf64>, rank 1, adjoint @p_grad
tai.field @q = @data["q"] : vector<2xf64>, rank 1, adjoint @q_grad
tai.field @n = @data["n"] : i32, rank 1
tai.field @next = @data["next"] : i32, rank 1
tai.field @a = @data["a"] : f64, rank 0, adjoint @a_grad
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

// x in [0.3, 1.5], trip counts 0 to 4, and lists i -> i / 2 -> ... -> 0.
tai.kernel @fill() {
  %scale = arith.constant 0.11 : f64
  %first = arith.constant 0.31 : f64
  %two = arith.constant 2 : i32
  %five = arith.constant 5 : i32
  %a = arith.constant 0.83 : f64
  tai.store %a, @a[] : f64
  tai.parallel_for (%i) in @x {
    %k = arith.index_cast %i : index to i32
    %f = arith.sitofp %k : i32 to f64
    %g = arith.mulf %f, %scale : f64
    %h = arith.addf %g, %first : f64
    tai.store %h, @x[%i] : f64
    %s = math.sin %f : f64
    %v = vector.from_elements %h, %s : vector<2xf64>
    tai.store %v, @p[%i] : vector<2xf64>
    %m = arith.remsi %k, %five : i32
    tai.store %m, @n[%i] : i32
    %half = arith.divsi %k, %two : i32
    tai.store %half, @next[%i] : i32
  }
  tai.return
}

// A branch that stays a branch, nested, with results and with accesses.
tai.kernel @branches() {
  %zero = arith.constant 0.0 : f64
  %half = arith.constant 0.55 : f64
  %one = arith.constant 1.05 : f64
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %a = tai.load @a[] : f64
    %low = arith.cmpf olt, %x, %half : f64
    %r, %q = scf.if %low -> (f64, f64) {
      %s = math.sqrt %x : f64
      %t = arith.divf %a, %s : f64
      scf.yield %t, %s : f64, f64
    } else {
      %high = arith.cmpf ogt, %x, %one : f64
      %u = scf.if %high -> (f64) {
        %l = math.log %x : f64
        %m = arith.mulf %l, %a : f64
        scf.yield %m : f64
      } else {
        scf.yield %a : f64
      }
      %w = arith.mulf %u, %x : f64
      scf.yield %w, %x : f64, f64
    }
    %big = arith.cmpf ogt, %x, %half : f64
    scf.if %big {
      %v = tai.load @y[%i] : f64
      %e = arith.divf %r, %x : f64
      %z = arith.mulf %e, %v : f64
      tai.atomic sub %z, @loss[] : f64
    }
    %p = arith.mulf %r, %q : f64
    tai.atomic add %p, @loss[] : f64
  }
  tai.return
}

tai.kernel @squares() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %s = arith.mulf %x, %x : f64
    tai.store %s, @y[%i] : f64
  }
  tai.return
}

// Carried values of three kinds: a sum (linear: no history), a product with a
// captured value, and a value that feeds a sine (history). The trip count comes
// from a field.
tai.kernel @carried() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f64
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %a = tai.load @a[] : f64
    %n32 = tai.load @n[%i] : i32
    %n = arith.index_cast %n32 : i32 to index
    %s = tai.alloca : !tai.local<f64>
    %m = tai.alloca : !tai.local<f64>
    %v = tai.alloca : !tai.local<vector<2xf64>>
    tai.local_store %x, %m : f64
    %v0 = tai.load @p[%i] : vector<2xf64>
    tai.local_store %v0, %v : vector<2xf64>
    scf.for %k = %c0 to %n step %c1 {
      %s0 = tai.local_load %s : f64
      %m0 = tai.local_load %m : f64
      %v1 = tai.local_load %v : vector<2xf64>
      %s1 = arith.addf %s0, %m0 : f64
      %m1 = arith.mulf %m0, %a : f64
      %t0 = math.sin %m1 : f64
      %b = vector.broadcast %t0 : f64 to vector<2xf64>
      %v2 = arith.mulf %v1, %b : vector<2xf64>
      %v3 = arith.addf %v2, %v0 : vector<2xf64>
      tai.local_store %s1, %s : f64
      tai.local_store %m1, %m : f64
      tai.local_store %v3, %v : vector<2xf64>
    }
    %s2 = tai.local_load %s : f64
    %m2 = tai.local_load %m : f64
    %v4 = tai.local_load %v : vector<2xf64>
    %d = tai.dot %v4, %v4 : vector<2xf64>
    %e = arith.mulf %m2, %d : f64
    %f = arith.addf %e, %s2 : f64
    tai.atomic add %f, @loss[] : f64
  }
  tai.return
}

// Loops in loops, with bounds that depend on the outer one, steps that are not
// one, and statements around the inner loop. All carried values are needed.
tai.kernel @nested() {
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c11 = arith.constant 11 : index
  %tenth = arith.constant 0.1 : f64
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %r = scf.for %k = %c2 to %c11 step %c3 iter_args(%v = %x) -> (f64) {
      %w0 = math.sin %v : f64
      %w1 = scf.for %j = %c1 to %k step %c2 iter_args(%w = %w0) -> (f64) {
        %y = tai.load @x[%j] : f64
        %p = arith.mulf %w, %y : f64
        %q = math.tanh %p : f64
        %h = arith.mulf %q, %v : f64
        scf.yield %h : f64
      }
      %o = arith.mulf %w1, %w1 : f64
      %t = arith.addf %o, %v : f64
      scf.yield %t : f64
    }
    %s = arith.mulf %r, %r : f64
    tai.atomic add %s, @loss[] : f64
  }
  tai.return
}

// Loop counters of 32 bits, from a negative bound, in steps of two, used as a
// number; and a carried integer that the gradient needs.
tai.kernel @counters() {
  %one = arith.constant 1 : i32
  %two = arith.constant 2 : i32
  %three = arith.constant 3 : i32
  %low = arith.constant -3 : i32
  %tenth = arith.constant 0.1 : f64
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %n = tai.load @n[%i] : i32
    %high = arith.muli %n, %two : i32
    %r:2 = scf.for %k = %low to %high step %two iter_args(%v = %x, %p = %one) -> (f64, i32) : i32 {
      %f = arith.sitofp %k : i32 to f64
      %g = arith.sitofp %p : i32 to f64
      %a = arith.mulf %f, %tenth : f64
      %b = arith.mulf %a, %v : f64
      %s = math.sin %b : f64
      %m = arith.mulf %g, %tenth : f64
      %w = arith.mulf %m, %v : f64
      %t = arith.addf %s, %w : f64
      %q = arith.muli %p, %three : i32
      %p2 = arith.remsi %q, %low : i32
      %p3 = arith.addi %p2, %two : i32
      scf.yield %t, %p3 : f64, i32
    }
    tai.atomic add %r#0, @loss[] : f64
  }
  tai.return
}

// A recurrence along a field inside a serial loop: iterations depend on each
// other through memory, so they must be reversed in order.
tai.kernel @recurrence() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c12 = arith.constant 12 : index
  %x0 = tai.load @x[%c0] : f64
  tai.store %x0, @y[%c0] : f64
  scf.for %t = %c1 to %c12 step %c1 {
    %before = arith.subi %t, %c1 : index
    %y = tai.load @y[%before] : f64
    %x = tai.load @x[%t] : f64
    %m = arith.mulf %y, %x : f64
    %s = math.sin %m : f64
    %a = tai.load @a[] : f64
    %r = arith.addf %s, %a : f64
    tai.store %r, @y[%t] : f64
  }
  %c11 = arith.constant 11 : index
  %l = tai.load @y[%c11] : f64
  %q = arith.mulf %l, %l : f64
  tai.atomic add %q, @loss[] : f64
  tai.return
}

// The same in a parallel loop that is asked to run in order.
tai.kernel @serialized() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c12 = arith.constant 12 : index
  %x0 = tai.load @x[%c0] : f64
  tai.store %x0, @y[%c0] : f64
  tai.parallel_for (%t) = (%c1) to (%c12) serialize {
    %before = arith.subi %t, %c1 : index
    %y = tai.load @y[%before] : f64
    %x = tai.load @x[%t] : f64
    %m = arith.mulf %y, %x : f64
    %s = math.cos %m : f64
    tai.store %s, @y[%t] : f64
  }
  %c11 = arith.constant 11 : index
  %l = tai.load @y[%c11] : f64
  tai.atomic add %l, @loss[] : f64
  tai.return
}

// A while loop that walks a list of integers and sums floats on the way.
tai.kernel @lists() {
  %zero = arith.constant 0 : i32
  tai.parallel_for (%i) in @x {
    %a = tai.load @a[] : f64
    %k = arith.index_cast %i : index to i32
    %end = scf.while (%at = %k) : (i32) -> i32 {
      %more = arith.cmpi sgt, %at, %zero : i32
      scf.condition(%more) %at : i32
    } do {
    ^bb0(%at: i32):
      %j = arith.index_cast %at : i32 to index
      %x = tai.load @x[%j] : f64
      %s = math.sin %x : f64
      %t = arith.mulf %s, %a : f64
      tai.atomic add %t, @loss[] : f64
      %next = tai.load @next[%j] : i32
      scf.yield %next : i32
    }
  }
  tai.return
}

// While loops that carry derivatives, with an exit that depends on data: in a
// branch, with a captured value, a vector, an integer that the gradient needs,
// a condition that computes the passed values, and one loop inside another.
tai.kernel @whiles() {
  %half = arith.constant 0.5 : f64
  %limit = arith.constant 2.5 : f64
  %zero = arith.constant 0 : i32
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %a = tai.load @a[] : f64
    %p = tai.load @p[%i] : vector<2xf64>
    %c = arith.cmpf ogt, %x, %half : f64
    %r = scf.if %c -> (f64) {
      %w:3 = scf.while (%v = %x, %q = %p, %k = %one) : (f64, vector<2xf64>, i32) -> (f64, vector<2xf64>, i32) {
        %g = arith.addf %v, %a : f64
        %more = arith.cmpf olt, %g, %limit : f64
        scf.condition(%more) %g, %q, %k : f64, vector<2xf64>, i32
      } do {
      ^bb0(%v: f64, %q: vector<2xf64>, %k: i32):
        %f = arith.sitofp %k : i32 to f64
        %s = math.sin %v : f64
        %t = arith.divf %s, %f : f64
        %u = arith.addf %v, %t : f64
        %b = vector.broadcast %s : f64 to vector<2xf64>
        %m = arith.mulf %b, %q : vector<2xf64>
        %inner:2 = scf.while (%z = %t, %j = %k) : (f64, i32) -> (f64, i32) {
          %go = arith.cmpi sgt, %j, %zero : i32
          scf.condition(%go) %z, %j : f64, i32
        } do {
        ^bb0(%z: f64, %j: i32):
          %y = math.cos %z : f64
          %y2 = arith.mulf %y, %v : f64
          %less = arith.subi %j, %one : i32
          scf.yield %y2, %less : f64, i32
        }
        %d = arith.mulf %inner#0, %half : f64
        %e = math.absf %d : f64
        %o = arith.addf %u, %e : f64
        %n = arith.addi %k, %one : i32
        scf.yield %o, %m, %n : f64, vector<2xf64>, i32
      }
      %l = tai.sum %w#1 : vector<2xf64>
      %h = arith.mulf %l, %w#0 : f64
      scf.yield %h : f64
    } else {
      %h = arith.mulf %x, %x : f64
      scf.yield %h : f64
    }
    tai.atomic add %r, @loss[] : f64
  }
  tai.return
}

// Variables, and accesses in both regions: a recurrence that reads and writes
// one field until a sum is reached.
tai.kernel @while_recurrence() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c11 = arith.constant 11 : index
  %limit = arith.constant 3.0 : f64
  %x0 = tai.load @x[%c0] : f64
  tai.store %x0, @y[%c0] : f64
  %sum = tai.alloca : !tai.local<f64>
  %at = tai.alloca : !tai.local<i32>
  scf.while : () -> () {
    %t32 = tai.local_load %at : i32
    %t = arith.index_cast %t32 : i32 to index
    %y = tai.load @y[%t] : f64
    %s = tai.local_load %sum : f64
    %r = arith.addf %s, %y : f64
    tai.local_store %r, %sum : f64
    %small = arith.cmpf olt, %r, %limit : f64
    %inside = arith.cmpi ult, %t, %c11 : index
    %more = arith.andi %small, %inside : i1
    scf.condition(%more)
  } do {
    %t32 = tai.local_load %at : i32
    %t = arith.index_cast %t32 : i32 to index
    %next = arith.addi %t, %c1 : index
    %y = tai.load @y[%t] : f64
    %x = tai.load @x[%next] : f64
    %m = arith.mulf %y, %x : f64
    %s = math.cos %m : f64
    tai.store %s, @y[%next] : f64
    %next32 = arith.index_cast %next : index to i32
    tai.local_store %next32, %at : i32
    scf.yield
  }
  %r = tai.local_load %sum : f64
  %q = arith.mulf %r, %r : f64
  tai.atomic add %q, @loss[] : f64
  tai.return
}

// Values of the top level that a parallel loop captures.
tai.kernel @captured() {
  %c3 = arith.constant 3 : index
  %a = tai.load @a[] : f64
  %s = math.sin %a : f64
  %p = tai.load @p[%c3] : vector<2xf64>
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %t = arith.mulf %x, %s : f64
    %b = vector.broadcast %t : f64 to vector<2xf64>
    %q = arith.mulf %b, %p : vector<2xf64>
    %n = tai.dot %q, %q : vector<2xf64>
    tai.atomic add %n, @loss[] : f64
  }
  tai.return
}

tai.kernel @clear() {
  %zero = arith.constant dense<0.0> : vector<2xf64>
  tai.parallel_for (%i) in @q {
    tai.store %zero, @q[%i] : vector<2xf64>
  }
  tai.return
}

// The same for values that a loop at the top level makes.
tai.kernel @captured_from_loop() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %v0 = tai.load @p[%c4] : vector<2xf64>
  %a0 = tai.load @a[] : f64
  %r:2 = scf.for %k = %c0 to %c4 step %c1 iter_args(%a = %a0, %v = %v0) -> (f64, vector<2xf64>) {
    %x = tai.load @x[%k] : f64
    %m = arith.mulf %x, %a : f64
    %s = math.sin %m : f64
    %b = vector.broadcast %s : f64 to vector<2xf64>
    %w = arith.mulf %v, %b : vector<2xf64>
    scf.yield %s, %w : f64, vector<2xf64>
  }
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %t = arith.mulf %x, %r#0 : f64
    %b = vector.broadcast %t : f64 to vector<2xf64>
    %q = arith.addf %b, %r#1 : vector<2xf64>
    %n = tai.dot %q, %q : vector<2xf64>
    tai.atomic add %n, @loss[] : f64
  }
  tai.return
}

// Scatter and gather at indices from a field, components of vectors, and a
// vector that is taken apart and put together at a position known at run time.
tai.kernel @indirect() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %k32 = tai.load @next[%i] : i32
    %k = arith.index_cast %k32 : i32 to index
    %x = tai.load @x[%k] : f64
    %p = tai.load @p[%i] component [%c1] : f64
    %q = arith.mulf %x, %p : f64
    tai.atomic add %q, @q[%k] component [%c0] : f64
    tai.atomic sub %x, @q[%i] component [%c1] : f64
  }
  tai.parallel_for (%i) in @x {
    %v = tai.load @q[%i] : vector<2xf64>
    %parity = arith.andi %i, %c1 : index
    %w = vector.extract %v[%parity] : f64 from vector<2xf64>
    %s = math.sin %w : f64
    %u = vector.insert %s, %v[%parity] : f64 into vector<2xf64>
    %e = vector.extract %u[0] : f64 from vector<2xf64>
    %r = vector.insert %e, %u[1] : f64 into vector<2xf64>
    %t = vector.shuffle %r, %v[1, 3, 0] : vector<2xf64>, vector<2xf64>
    %z = vector.reduction <mul>, %t : vector<3xf64> into f64
    %y = vector.reduction <maximumf>, %v : vector<2xf64> into f64
    %g = arith.addf %z, %y : f64
    tai.atomic add %g, @loss[] : f64
  }
  tai.return
}

func.func @main() {
  %zero = arith.constant 0.0 : f64
  tai.launch @fill() : () -> ()
  tai_check.gradient loss(@loss) wrt [@x, @a] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @squares() : () -> ()
    tai.launch @branches() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @a, @p] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @carried() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @nested() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @counters() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @a] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @recurrence() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @serialized() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @a] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @lists() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @a, @p] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @whiles() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @while_recurrence() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @a, @p] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @captured() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @a, @p] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @captured_from_loop() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @p] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @clear() : () -> ()
    tai.launch @indirect() : () -> ()
  }
  return
}
