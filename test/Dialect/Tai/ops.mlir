// RUN: tai-opt %s --verify-roundtrip | FileCheck %s
// RUN: tai-opt %s --emit-bytecode | tai-opt | FileCheck %s
// RUN: tai-opt %s --mlir-print-op-generic | tai-opt | FileCheck %s

// The examples of the op descriptions, in one module.

// CHECK: tai.tree @scene : !tai.root<dense<[i: 256]
tai.tree @scene : !tai.root<
  dense<[i: 256], {x: f32, x_grad: f32, x_dual: f32, y: f32}>,
  dense<[i: 8, j: 4], {v: vector<2xf32>}>,
  dynamic<[i: 16], chunk 4, {list: f32}>,
  pointer<[i: 16], dense<[i: 4], {s: f32}>>,
  {loss: f64, loss_grad: f64}>

// CHECK: tai.field @x_grad = @scene["x_grad"] : f32, rank 1
tai.field @x_grad = @scene["x_grad"] : f32, rank 1
tai.field @x_dual = @scene["x_dual"] : f32, rank 1
// CHECK: tai.field @x = @scene["x"] : f32, rank 1, adjoint @x_grad, dual @x_dual, offset [-3]
tai.field @x = @scene["x"] : f32, rank 1, offset [-3], adjoint @x_grad, dual @x_dual
tai.field @y = @scene["y"] : f32, rank 1
// CHECK: tai.field @v = @scene["v"] : vector<2xf32>, rank 2, order [1, 0]
tai.field @v = @scene["v"] : vector<2xf32>, rank 2, order [1, 0]
tai.field @list = @scene["list"] : f32, rank 1
tai.field @s = @scene["s"] : f32, rank 1
tai.field @loss_grad = @scene["loss_grad"] : f64, rank 0
tai.field @loss = @scene["loss"] : f64, rank 0, adjoint @loss_grad

// CHECK-LABEL: tai.kernel @square(
// CHECK-SAME:      %[[A:.+]]: f32)
tai.kernel @square(%a: f32) {
  // CHECK: tai.parallel_for (%[[I:.+]]) in @x {
  tai.parallel_for (%i) in @x {
    // CHECK: %[[X:.+]] = tai.load @x[%[[I]]] : f32
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    %2 = arith.mulf %1, %a : f32
    // CHECK: tai.store %{{.+}}, @y[%[[I]]] : f32
    tai.store %2, @y[%i] : f32
  }
  // CHECK: tai.return
  tai.return
}

// CHECK-LABEL: tai.kernel @seven() -> i32
tai.kernel @seven() -> i32 {
  %c = arith.constant 7 : i32
  // CHECK: tai.return %{{.+}} : i32
  tai.return %c : i32
}

// CHECK-LABEL: tai.kernel @loops(
// CHECK-SAME:      %[[N:.+]]: index, %{{.+}}: memref<?x4xf32>) attributes {adjoint = @square, summary = [#tai.access<read @x, #{{.+}}>, #tai.access<accumulate @loss>]}
tai.kernel @loops(%n: index, %array: memref<?x4xf32>) attributes {
    adjoint = @square,
    summary = [#tai.access<read @x, affine_map<(d0)[s0] -> (s0 - d0)>>,
               #tai.access<accumulate @loss>]} {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f32
  // CHECK: tai.parallel_for (%[[I:.+]], %[[J:.+]]) = (%[[C0:.+]], %[[C0]]) to (%[[N]], %[[N]]) {
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%n, %n) {
    // CHECK: memref.store %{{.+}}, %{{.+}}[%[[I]], %[[J]]] : memref<?x4xf32>
    memref.store %zero, %array[%i, %j] : memref<?x4xf32>
  }
  // CHECK: tai.parallel_for (%{{.+}}) = ({{.+}}) to ({{.+}}) serialize block_dim 64 {
  tai.parallel_for (%i) = (%c0) to (%n) serialize block_dim 64 {
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @accesses(
tai.kernel @accesses(%i: index, %j: index) {
  %c1 = arith.constant 1 : index
  // CHECK: %[[V:.+]] = tai.load @v[%[[I:.+]], %[[J:.+]]] : vector<2xf32>
  %v = tai.load @v[%i, %j] : vector<2xf32>
  // CHECK: %[[Y:.+]] = tai.load @v[%[[I]], %[[J]]] component[%[[C1:.+]]] : f32
  %y = tai.load @v[%i, %j] component [%c1] : f32
  // CHECK: tai.store %[[V]], @v[%[[I]], %[[J]]] : vector<2xf32>
  tai.store %v, @v[%i, %j] : vector<2xf32>
  // CHECK: tai.store %[[Y]], @v[%[[I]], %[[J]]] component[%[[C1]]] : f32
  tai.store %y, @v[%i, %j] component [%c1] : f32
  // CHECK: tai.atomic add %[[V]], @v[%[[I]], %[[J]]] : vector<2xf32>
  %o0 = tai.atomic add %v, @v[%i, %j] : vector<2xf32>
  // CHECK: tai.atomic max %[[Y]], @v[%[[I]], %[[J]]] component[%[[C1]]] exclusive : f32
  %o1 = tai.atomic max %y, @v[%i, %j] component [%c1] exclusive : f32
  tai.return
}

// CHECK-LABEL: tai.kernel @topology(
tai.kernel @topology(%i: index, %f: f32) {
  // CHECK: tai.activate @s[%[[I:.+]]] level 2
  tai.activate @s[%i] level 2
  // CHECK: tai.deactivate @s[%[[I]]] level 2
  tai.deactivate @s[%i] level 2
  // CHECK: tai.is_active @s[%[[I]]] level 1
  %a = tai.is_active @s[%i] level 1
  // CHECK: tai.append %{{.+}}, @list[] : f32
  %at = tai.append %f, @list[] : f32
  // CHECK: tai.length @list[]
  %n = tai.length @list[]
  tai.return
}

// CHECK-LABEL: tai.kernel @locals(
tai.kernel @locals(%x: f32, %i: index, %ok: i1) -> f32 {
  // CHECK: %[[A:.+]] = tai.alloca : !tai.local<f32>
  %a = tai.alloca : !tai.local<f32>
  // CHECK: tai.local_store %{{.+}}, %[[A]] : f32
  tai.local_store %x, %a : f32
  // CHECK: %[[Y:.+]] = tai.local_load %[[A]] : f32
  %y = tai.local_load %a : f32
  // CHECK: tai.random stream 0 : f32
  %u = tai.random stream 0 : f32
  // CHECK: tai.assert %{{.+}}, "mass {} of particle {}"(%{{.+}}, %{{.+}}) : f32, index
  tai.assert %ok, "mass {} of particle {}"(%x, %i) : f32, index
  // CHECK: tai.precondition %{{.+}}, "step {}"(%{{.+}}) : index
  tai.precondition %ok, "step {}"(%i) : index
  // CHECK: tai.print "x = {}"(%{{.+}}) : f32
  tai.print "x = {}"(%x) : f32
  // CHECK: tai.print "x = {}"(%{{.+}}) : f32 {no_newline}
  tai.print "x = {}"(%x) : f32 {no_newline}
  tai.return %y : f32
}

// CHECK-LABEL: tai.kernel @stacks(
tai.kernel @stacks(%x: f32) -> f32 {
  // CHECK: %[[S:.+]] = tai.stack_create : !tai.stack<f32>
  %s = tai.stack_create : !tai.stack<f32>
  // CHECK: tai.stack_push %{{.+}}, %[[S]] : f32
  tai.stack_push %x, %s : f32
  // CHECK: tai.stack_pop %[[S]] : f32
  %y = tai.stack_pop %s : f32
  // CHECK: tai.stack_destroy %[[S]] : !tai.stack<f32>
  tai.stack_destroy %s : !tai.stack<f32>
  tai.return %y : f32
}

// CHECK-LABEL: tai.kernel @matrices(
tai.kernel @matrices(%a: vector<2x3xf32>, %b: vector<3x2xf32>,
                     %m: vector<3x3xf32>, %q: vector<2x2xf32>,
                     %v: vector<3xf32>, %w: vector<2xf32>) {
  // CHECK: tai.matmul %{{.+}}, %{{.+}} : (vector<2x3xf32>, vector<3x2xf32>) -> vector<2x2xf32>
  %c = tai.matmul %a, %b : (vector<2x3xf32>, vector<3x2xf32>) -> vector<2x2xf32>
  // CHECK: tai.matmul %{{.+}}, %{{.+}} : (vector<2x3xf32>, vector<3xf32>) -> vector<2xf32>
  %mv = tai.matmul %a, %v : (vector<2x3xf32>, vector<3xf32>) -> vector<2xf32>
  // CHECK: tai.transpose %{{.+}} : vector<2x3xf32> -> vector<3x2xf32>
  %t = tai.transpose %a : vector<2x3xf32> -> vector<3x2xf32>
  // CHECK: tai.dot %{{.+}}, %{{.+}} : vector<3xf32>
  %d = tai.dot %v, %v : vector<3xf32>
  // CHECK: tai.sum %{{.+}} : vector<2x2xf32>
  %s = tai.sum %q : vector<2x2xf32>
  // CHECK: tai.cross %{{.+}}, %{{.+}} : vector<3xf32>
  %x = tai.cross %v, %v : vector<3xf32>
  // CHECK: tai.outer %{{.+}}, %{{.+}} : (vector<2xf32>, vector<3xf32>) -> vector<2x3xf32>
  %o = tai.outer %w, %v : (vector<2xf32>, vector<3xf32>) -> vector<2x3xf32>
  // CHECK: tai.norm %{{.+}} : vector<2xf32>
  %l = tai.norm %w : vector<2xf32>
  // CHECK: tai.norm fast %{{.+}} : vector<2xf32>
  %fast = tai.norm fast %w : vector<2xf32>
  // CHECK: tai.trace %{{.+}} : vector<3x3xf32>
  %tr = tai.trace %m : vector<3x3xf32>
  // CHECK: tai.determinant %{{.+}} : vector<3x3xf32>
  %det = tai.determinant %m : vector<3x3xf32>
  // CHECK: tai.inverse %{{.+}} : vector<2x2xf32>
  %inv = tai.inverse %q : vector<2x2xf32>
  // CHECK: tai.solve %{{.+}}, %{{.+}} : vector<3x3xf32>, vector<3xf32>
  %sol = tai.solve %m, %v : vector<3x3xf32>, vector<3xf32>
  // CHECK: tai.polar %{{.+}} : vector<2x2xf32>
  %r, %st = tai.polar %q : vector<2x2xf32>
  // CHECK: tai.svd %{{.+}} : vector<3x3xf32>
  %u, %sg, %vt = tai.svd %m : vector<3x3xf32>
  // CHECK: tai.sym_eig %{{.+}} : vector<2x2xf32> -> vector<2xf32>
  %ev, %ew = tai.sym_eig %q : vector<2x2xf32> -> vector<2xf32>
  tai.return
}

// CHECK-LABEL: func.func @main(
func.func @main(%f: f32) {
  // CHECK: tai.tape loss(@loss) {
  tai.tape loss(@loss) {
    // CHECK: tai.launch @square(%{{.+}}) : (f32) -> ()
    tai.launch @square(%f) : (f32) -> ()
  }
  // CHECK: tai_check.gradient loss(@loss) wrt [@x] tolerance {{.+}} {
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    %0 = tai.launch @seven() : () -> i32
  }
  // CHECK: tai_check.close %{{.+}}, %{{.+}} tolerance {{.+}} : f32
  tai_check.close %f, %f tolerance 1.0e-6 : f32
  return
}
