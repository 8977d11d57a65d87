// RUN: tai-run %s --no-cache

// A loop that carries y *= c for n trips, n from a field: the gradient is right
// for any n, d/dx = c^n and d/dc = n c^(n - 1) x.

tai.tree @data : !tai.root<
    dense<[i: 5], {n: i32, x: f64, x_grad: f64, c: f64, c_grad: f64}>,
    {loss: f64, loss_grad: f64}>
tai.field @n = @data["n"] : i32, rank 1
tai.field @x_grad = @data["x_grad"] : f64, rank 1
tai.field @x = @data["x"] : f64, rank 1, adjoint @x_grad
tai.field @c_grad = @data["c_grad"] : f64, rank 1
tai.field @c = @data["c"] : f64, rank 1, adjoint @c_grad
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @powers() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %n32 = tai.load @n[%i] : i32
    %n = arith.index_cast %n32 : i32 to index
    %x = tai.load @x[%i] : f64
    %c = tai.load @c[%i] : f64
    %y = tai.alloca : !tai.local<f64>
    tai.local_store %x, %y : f64
    scf.for %k = %c0 to %n step %c1 {
      %0 = tai.local_load %y : f64
      %1 = arith.mulf %0, %c : f64
      tai.local_store %1, %y : f64
    }
    %r = tai.local_load %y : f64
    tai.atomic add %r, @loss[] : f64
  }
  tai.return
}

func.func private @set(%i: index, %n: i32, %c: f64) {
  %x = arith.constant 1.5 : f64
  tai.store %n, @n[%i] : i32
  tai.store %x, @x[%i] : f64
  tai.store %c, @c[%i] : f64
  return
}

func.func private @check(%i: index) {
  %one = arith.constant 1 : i32
  %n = tai.load @n[%i] : i32
  %x = tai.load @x[%i] : f64
  %c = tai.load @c[%i] : f64
  %nf = arith.sitofp %n : i32 to f64
  %dx = math.fpowi %c, %n : f64, i32
  %m = arith.subi %n, %one : i32
  %p = math.fpowi %c, %m : f64, i32
  %px = arith.mulf %p, %x : f64
  %dc = arith.mulf %nf, %px : f64
  %gx = tai.load @x_grad[%i] : f64
  %gc = tai.load @c_grad[%i] : f64
  tai_check.close %gx, %dx tolerance 1.0e-9 : f64
  tai_check.close %gc, %dc tolerance 1.0e-9 : f64
  return
}

func.func @main() {
  %i0 = arith.constant 0 : index
  %i1 = arith.constant 1 : index
  %i2 = arith.constant 2 : index
  %i3 = arith.constant 3 : index
  %i4 = arith.constant 4 : index
  %n0 = arith.constant 30 : i32
  %n1 = arith.constant 31 : i32
  %n2 = arith.constant 100 : i32
  %n3 = arith.constant 5000 : i32
  %n4 = arith.constant 1000000 : i32
  %b0 = arith.constant 0.9 : f64
  %b1 = arith.constant 1.1 : f64
  %b2 = arith.constant 1.01 : f64
  %b3 = arith.constant 0.9999 : f64
  %b4 = arith.constant 1.000001 : f64
  func.call @set(%i0, %n0, %b0) : (index, i32, f64) -> ()
  func.call @set(%i1, %n1, %b1) : (index, i32, f64) -> ()
  func.call @set(%i2, %n2, %b2) : (index, i32, f64) -> ()
  func.call @set(%i3, %n3, %b3) : (index, i32, f64) -> ()
  func.call @set(%i4, %n4, %b4) : (index, i32, f64) -> ()
  tai.tape loss(@loss) {
    tai.launch @powers() : () -> ()
  }
  func.call @check(%i0) : (index) -> ()
  func.call @check(%i1) : (index) -> ()
  func.call @check(%i2) : (index) -> ()
  func.call @check(%i3) : (index) -> ()
  func.call @check(%i4) : (index) -> ()
  return
}
